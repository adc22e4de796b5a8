"""The figures of a start are those of all starts that were made, not of the best one."""

from bench import startup


def test_median_and_most_are_told_and_the_goal_is_the_medians():
    figure = startup._figure("a start", [(0.9, 0.5), (1.4, 0.6), (1.1, 0.7)], ", more")
    assert figure.value == "median 1.10 s, most 1.40 s, least 0.90 s of 3 (CPU 0.60 s), more"
    assert figure.reached is False


def test_there_are_rows_of_a_cold_start_and_of_one_beside_busy_processes(monkeypatch):
    done = []
    monkeypatch.setattr(startup, "_start", lambda arguments, before=(): done.append(before or arguments) or (0.5, 0.4))
    monkeypatch.setattr(startup, "_may_raise_priority", lambda: True)
    monkeypatch.setattr(startup, "_bare", lambda: 0.1)
    monkeypatch.setattr(startup, "_drop_cached", lambda: done.append("dropped"))
    names = [figure.name for figure in startup.measure(quick=True)]
    assert names[1] == "the same, nothing of the environment in the page cache"
    assert names[2].startswith("the same, beside ")
    assert names[3] == names[2] + ", at the priority of the systemd unit"
    assert done.index("dropped") + 1 < len(done)
    assert done[-1] == ["nice", "-n", "-10"]
