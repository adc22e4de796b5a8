"""UNIX time to GPS week and time of week, against dates whose GPS time is published."""

from datetime import UTC, datetime

from gcs_coloc.core.clocks.utc import TABLE_GOOD_UNTIL, gps_week_and_ms, table_is_old


def unix(*date: int) -> float:
    return datetime(*date, tzinfo=UTC).timestamp()


def test_week_rollover_of_april_2019_began_18_s_before_utc_midnight():
    assert gps_week_and_ms(unix(2019, 4, 6, 23, 59, 42)) == (2048, 0)
    assert gps_week_and_ms(unix(2019, 4, 6, 23, 59, 41)) == (2047, 604_799_000)


def test_the_leap_second_of_new_year_2017_is_taken_at_its_date():
    before, after = gps_week_and_ms(unix(2016, 12, 31, 23, 59, 59)), gps_week_and_ms(unix(2017, 1, 1))
    assert before == (1930, 16_000)
    assert after == (1930, 18_000)


def test_milliseconds_carry_into_the_next_week():
    assert gps_week_and_ms(unix(2019, 4, 6, 23, 59, 41) + 0.9996) == (2048, 0)


def test_times_before_the_table_are_not_guessed():
    assert gps_week_and_ms(0.0) == (0, 0)


def test_the_table_says_when_it_is_old():
    assert not table_is_old(TABLE_GOOD_UNTIL.timestamp() - 1)
    assert table_is_old(TABLE_GOOD_UNTIL.timestamp())
