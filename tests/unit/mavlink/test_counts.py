from gcs_coloc.mavlink.counts import MAX_REASONS, Counts


def test_counts_add_up_by_reason():
    counts = Counts()
    counts.add("bad_crc")
    counts.add("bad_crc", 2)
    assert dict(counts) == {"bad_crc": 3}
    assert counts["never"] == 0
    assert "never" not in counts


def test_reasons_are_bounded_and_nothing_goes_uncounted():
    counts = Counts()
    for number in range(10 * MAX_REASONS):
        counts.add(f"reason {number}")
    assert len(counts) <= MAX_REASONS + 1
    assert sum(counts.values()) == 10 * MAX_REASONS
