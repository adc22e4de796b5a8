"""PyFG files become data sets that can be evaluated."""

import math

import pytest
from typer.testing import CliRunner

from gcs_coloc.cli.main import app
from gcs_coloc.core.errors import DataError, UsageError
from gcs_coloc.core.measurements import PositionMeasurement, RangeMeasurement
from gcs_coloc.estimators.fleet.filter import FleetFilter
from gcs_coloc.evaluation.dataset import read_dataset
from gcs_coloc.evaluation.evaluate import evaluate
from gcs_coloc.evaluation.pyfg import import_pyfg

LANDMARKS = {"L0": (0.0, 0.0), "L1": (30.0, 0.0), "L2": (0.0, 30.0), "L3": (30.0, 30.0)}


def graph(extra=()):
    """A robot A that walks among four landmarks, a robot B beside it, times far from zero."""
    vertices, ranges = [f"VERTEX_XY {name} {x} {y}" for name, (x, y) in LANDMARKS.items()], []
    for k in range(120):
        t, place = 1_600_000_000.0 + 0.25 * k, (10.0 + 0.1 * k, 8.0 + 0.05 * k)
        vertices.append(f"VERTEX_SE2 {t:.9f} A{k} {place[0]:.6f} {place[1]:.6f} 0.4636476")
        vertices.append(f"VERTEX_SE2 {t:.9f} B{k} 5.0 20.0 0.0")
        ranges += [f"EDGE_RANGE {t:.9f} A{k} {name} {math.dist(place, where):.6f} 0.010000" for name, where in LANDMARKS.items()]
        ranges.append(f"EDGE_RANGE {t:.9f} A{k} B{k} {math.dist(place, (5.0, 20.0)):.6f} 0.010000")
    odometry = [
        "EDGE_SE2 1600000000.0 A0 A1 0.1 0.05 0.0 0.1 0 0 0.1 0 0.1",
        "VERTEX_SE2:PRIOR 1600000000.0 A0 10 8 0 1 0 0 1 0 1",
    ]
    return "\n".join([*vertices, *odometry, *ranges, *extra]) + "\n"


def test_a_graph_becomes_a_data_set_that_is_located(tmp_path):
    (tmp_path / "walk.pyfg").write_text(graph())
    found = import_pyfg(tmp_path / "walk.pyfg", tmp_path / "set", (), 0.2, 1)
    assert (found.denied, found.peers, found.anchors, found.ranges, found.dropped) == (("A",), ("B",), 4, 600, ())
    dataset = read_dataset(tmp_path / "set")
    assert (dataset.dims, dataset.dropped) == (2, ())
    assert sum(isinstance(m, RangeMeasurement) for m in dataset.measurements) == 600
    assert dataset.measurements[0].measured_at_s == 0.0
    reports = [m for m in dataset.measurements if isinstance(m, PositionMeasurement)]
    assert [m.vehicle for m in reports].count(1) == 1
    (vehicle,) = evaluate(tmp_path / "set", FleetFilter()).denied
    assert vehicle.score.share_known > 0.95
    assert vehicle.score.horizontal.rmse_m < 0.3


def test_three_dimensions_and_another_robot(tmp_path):
    lines = [f"VERTEX_XYZ L{k} {10 * k} {k} 1.0" for k in range(2)]
    lines += [f"VERTEX_SE3:QUAT {k}.0 {robot}{k} {k} 2.0 3.0 0 0 0 1" for k in range(3) for robot in "AB"]
    lines += [f"EDGE_RANGE {k}.0 B{k} L1 5.0 0.04" for k in range(3)]
    (tmp_path / "x.pyfg").write_text("\n".join(lines))
    assert import_pyfg(tmp_path / "x.pyfg", tmp_path / "set", ("B",), 0.2, 1).denied == ("B",)
    dataset = read_dataset(tmp_path / "set")
    assert dataset.dims == 3
    (node,) = dataset.denied()
    assert dataset.truth[node.vehicle].positions_enu_m[2].tolist() == [2.0, 2.0, 3.0]
    assert next(m.sigma_m for m in dataset.measurements if isinstance(m, RangeMeasurement)) == pytest.approx(0.2)


@pytest.mark.parametrize(
    "line",
    [
        "EDGE_RANGE 1600000001.0 A4 L1 -3.0 0.01",
        "EDGE_RANGE 1600000001.0 A4 L9x 3.0 0.01",
        "EDGE_RANGE 16",
        "VERTEX_SE3:QUAT 1600000001.0 A9 1 2 3 0 0 0 1",
        "EDGE_RANGE 1 A4 L1 nan 1",
    ],
)
def test_a_wrong_line_is_left_out_and_told(tmp_path, line):
    (tmp_path / "x.pyfg").write_text(graph([line]))
    ran = CliRunner().invoke(app, ["import", "pyfg", str(tmp_path / "x.pyfg"), str(tmp_path / "set")])
    assert ran.exit_code == 0, ran.output
    assert "1 lines are wrong and left out" in ran.stderr
    assert f"line {len(graph().splitlines()) + 1}" in ran.stderr
    assert "600 ranges" in ran.stdout


def test_other_files_are_refused(tmp_path):
    (tmp_path / "x.pyfg").write_text("t_s,from,to\n1,2,3\n")
    with pytest.raises(DataError, match=r"line 1.*is it a PyFG file"):
        import_pyfg(tmp_path / "x.pyfg", tmp_path / "set", (), 0.2, 1)
    (tmp_path / "y.pyfg").write_text(graph())
    with pytest.raises(UsageError, match="no robot 'Z'; there are A, B"):
        import_pyfg(tmp_path / "y.pyfg", tmp_path / "set", ("Z",), 0.2, 1)
    with pytest.raises(DataError, match="cannot be read"):
        import_pyfg(tmp_path / "absent.pyfg", tmp_path / "set", (), 0.2, 1)


def test_names_with_quotes_and_backslashes_are_kept(tmp_path):
    file = tmp_path / 'my "best" \\run.pyfg'
    file.write_text(graph().replace("L1", 'L"1'))
    import_pyfg(file, tmp_path / "set", (), 0.2, 1)
    dataset = read_dataset(tmp_path / "set")
    assert dataset.name == 'my "best" \\run'
    assert 'L"1' in {node.id for node in dataset.nodes}


@pytest.mark.parametrize(
    ("lines", "told"),
    [("VERTEX_SE2 0.0 A0 1 2 0\nVERTEX_XY L0 0 0\nEDGE_RANGE 0 A0 L0 1 -1\n", "line 3: a range of 1 m"), ("", "no EDGE_RANGE")],
)
def test_a_file_without_a_good_range_tells_why(tmp_path, lines, told):
    (tmp_path / "x.pyfg").write_text(lines)
    with pytest.raises(DataError, match=told):
        import_pyfg(tmp_path / "x.pyfg", tmp_path / "set", (), 0.2, 1)


def test_a_line_that_is_too_short_is_told_in_words(tmp_path):
    (tmp_path / "x.pyfg").write_text(graph(["EDGE_RANGE 16"]))
    assert (
        import_pyfg(tmp_path / "x.pyfg", tmp_path / "set", (), 0.2, 1).dropped[0].endswith("2 words are too few for EDGE_RANGE")
    )
