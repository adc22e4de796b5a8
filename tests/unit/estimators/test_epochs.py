from gcs_coloc.core.measurements import RangeMeasurement
from gcs_coloc.estimators.qu_zhang.denied_vehicle import RangeEpochGatherer


def one_range(peer: int, measured_at_s: float, arrived_at_s: float) -> RangeMeasurement:
    return RangeMeasurement(9, peer, measured_at_s, arrived_at_s, 100.0, 1.0)


def peers_of(gatherer: RangeEpochGatherer, *ranges: tuple[int, float, float]) -> list[list[int]]:
    complete = []
    for peer, measured_at_s, arrived_at_s in ranges:
        epoch = gatherer.add(peer, one_range(peer, measured_at_s, arrived_at_s))
        if epoch is not None:
            complete.append(sorted(epoch.ranges))
    return complete


def test_an_epoch_is_complete_as_soon_as_all_who_were_heard_are_in() -> None:
    gatherer = RangeEpochGatherer(0.25, 0.5)

    assert peers_of(gatherer, (1, 0.0, 0.1), (2, 0.0, 0.1), (3, 0.05, 0.1)) == [[1, 2, 3]]
    assert gatherer.pop_due(100.0) == []


def test_a_fourth_peer_is_waited_for_and_not_for_ever() -> None:
    gatherer = RangeEpochGatherer(0.25, 0.5)
    peers_of(gatherer, (1, 0.0, 0.0), (2, 0.0, 0.0), (3, 0.0, 0.0), (4, 0.0, 0.0))
    gatherer.pop_due(0.9)

    assert peers_of(gatherer, (1, 1.0, 1.0), (2, 1.0, 1.0), (3, 1.0, 1.0)) == []
    assert gatherer.pop_due(1.4) == []
    [due] = gatherer.pop_due(1.6)
    assert sorted(due.ranges) == [1, 2, 3]
    # Silent for more than two seconds, it is waited for no more.
    assert peers_of(gatherer, (1, 3.0, 3.0), (2, 3.0, 3.0), (3, 3.0, 3.0)) == [[1, 2, 3]]


def test_ranges_of_later_epochs_that_overtake_find_their_own() -> None:
    gatherer = RangeEpochGatherer(0.25, 0.5)
    complete = peers_of(
        gatherer, (1, 0.0, 0.05), (1, 0.1, 0.15), (2, 0.0, 0.2), (1, 0.2, 0.25), (2, 0.1, 0.3), (3, 0.0, 0.4), (3, 0.1, 0.5)
    )

    assert complete == [[1, 2, 3], [1, 2, 3]]
    [rest] = gatherer.pop_due(2.0)
    assert rest.newest_s == 0.2


def test_ranges_too_far_apart_in_time_are_no_epoch() -> None:
    gatherer = RangeEpochGatherer(0.25, 0.5)

    assert peers_of(gatherer, (1, 0.0, 0.3), (2, 0.3, 0.3), (3, 0.15, 0.3)) == []


def test_due_epochs_come_oldest_first_and_waiting_ones_are_bounded() -> None:
    gatherer = RangeEpochGatherer(0.01, 0.5)
    for k in range(200):
        gatherer.add(1, one_range(1, 10.0 - 0.04 * k, 10.0))
    due = gatherer.pop_due(10.1)

    assert len(due) == 200 - 64
    assert [epoch.newest_s for epoch in due] == sorted(epoch.newest_s for epoch in due)
    assert len(gatherer.pop_due(11.0)) == 64
