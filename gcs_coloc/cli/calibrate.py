"""`gcs-coloc calibrate`: bias and scale of ranging devices from a recording, as configuration."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from gcs_coloc.cli.recordings import ConfigOption, FleetOption, RangesOption, settings_for, warn_of_damage
from gcs_coloc.cli.task_options import result_console
from gcs_coloc.core.errors import DataError, UsageError
from gcs_coloc.core.stations.node_id import is_station, station_id_of
from gcs_coloc.evaluation.calibration import Calibration
from gcs_coloc.evaluation.calibration import calibrate as calibrate_devices
from gcs_coloc.runtime.files import check_output_file, new_table, writing


def calibrate(
    source: Annotated[Path, typer.Argument(help="A data set, or a recording of a flight with GPS.", metavar="DIR|FILE.tlog")],
    ranges: RangesOption = None,
    truth: Annotated[Path | None, typer.Option(help="True positions: unix_s,sysid,lat_deg,lon_deg,alt_msl_m.")] = None,
    config: ConfigOption = None,
    fleet: FleetOption = None,
    out: Annotated[Path | None, typer.Option(help="Write the configuration into this file instead of printing it.")] = None,
) -> None:
    """Estimate bias and scale of each ranging device from a flight with all positions known.

    The result is printed as configuration.
    """
    from gcs_coloc.evaluation.data_checks.recorded_data import recorded_data
    from gcs_coloc.evaluation.dataset import read_dataset

    check_output_file(out, "--out")
    if source.is_dir():
        if any(option is not None for option in (ranges, truth, config, fleet)):
            raise UsageError("--ranges, --truth, --config and --fleet are of a recording; a data set has its own")
        data = recorded_data(read_dataset(source))
    else:
        from gcs_coloc.recorder.flight_history import read_history

        history = read_history(source, settings_for(config, fleet, None), ranges, truth)
        warn_of_damage(source, history.damage)
        if history.recorded is None:
            raise DataError(f"{source}: no vehicle has a position: nothing to calibrate with")
        data = history.recorded
    try:
        found = calibrate_devices(data)
    except DataError as error:
        raise DataError(f"{source}: {error}") from None
    console = result_console()
    console.print(_devices(found, data.names))
    console.print(_pairs(found, data.names))
    text = _as_dataset(found, data.names) if source.is_dir() else _as_configuration(found)
    if out is None:
        print(text, end="")
        return
    with writing(out, "--out"):
        out.write_text(text, encoding="utf-8")
    print(f"written: {out}")


def _devices(found: Calibration, names: Mapping[int, str]) -> Table:
    headings = ("device", "bias m", "1-sigma", "scale", "1-sigma", "ranges")
    table = new_table(*headings, left=("device",), title="Devices: what is added to the distance")
    for d in found.devices:
        numbers = (f"{d.bias_m:+.3f}", f"{d.bias_sigma_m:.3f}", f"{d.scale:+.5f}", f"{d.scale_sigma:.5f}", str(d.ranges))
        table.add_row(names[d.vehicle], *numbers)
    return table


def _pairs(found: Calibration, names: Mapping[int, str]) -> Table:
    headings = ("pair", "ranges", "before", "after", "scatter")
    table = new_table(*headings, left=("pair",), title="Pairs: median residual, m")
    for p in found.pairs:
        pair = "-".join(names[end] for end in p.ends)
        table.add_row(pair, str(p.ranges), f"{p.before_m:+.3f}", f"{p.after_m:+.3f}", f"{p.rms_m:.3f}")
    return table


def _as_configuration(found: Calibration) -> str:
    vehicles, stations = ([d for d in found.devices if is_station(d.vehicle) is wanted] for wanted in (False, True))
    biases = "".join(f"{d.vehicle} = {d.bias_m:.3f}\n" for d in vehicles)
    scales = "".join(f"{d.vehicle} = {d.scale:.5f}\n" for d in vehicles)
    of_stations = (
        f"\n# into [[station]] id = {station_id_of(d.vehicle)}\n# range_bias_m = {d.bias_m:.3f}\n# range_scale = {d.scale:.5f}\n"
        for d in stations
    )
    return f"[measurements.range_bias_m]\n{biases}\n[measurements.range_scale]\n{scales}{''.join(of_stations)}"


def _as_dataset(found: Calibration, names: Mapping[int, str]) -> str:
    tables = (f'# id = "{names[d.vehicle]}"\nrange_bias_m = {d.bias_m:.3f}\nrange_scale = {d.scale:.5f}\n' for d in found.devices)
    return "# into meta.toml, to each [[node]]\n" + "".join(tables)
