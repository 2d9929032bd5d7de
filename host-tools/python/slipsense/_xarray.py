"""An episode as an xarray data set."""

import json

import numpy
import xarray

from ._slipsense import COL_PITCH_MM, ROW_PITCH_MM, pressure_table_kpa

PER_FRAME = {"label": "0 no contact, 1 no slip, 2 slip", "slip_true": "mm/s", "slip_fraction": "1", "displacement_mm": "mm"}


def dataset(episode):
    meta = json.loads(episode.meta)
    xl, (rows, cols) = episode.xl, episode.piezo.shape[2:]

    def variable(dims, values, units):
        return dims, values, {"units": units}

    variables = {
        "pressure": variable(("frame", "sensor", "row", "col"), pressure_table_kpa()[episode.piezo], "kPa"),
        "acceleration": variable(("sensor", "sample", "axis"), (xl * meta["xl_lsb_g"]).astype(numpy.float32), "g"),
        "xl_end": variable(("frame", "sensor"), episode.xl_end, "samples"),
    }
    for name, units in PER_FRAME.items():
        if (values := getattr(episode, name)) is not None:
            variables[name] = variable(("frame",), values, units)
    coords = {
        "time": variable(("frame",), numpy.arange(episode.frames) / meta["frame_rate_hz"], "s"),
        "sample_time": variable(("sample",), numpy.arange(xl.shape[1]) / meta["xl_rate_hz"], "s"),
        "row_mm": variable(("row",), numpy.arange(rows) * ROW_PITCH_MM, "mm"),
        "col_mm": variable(("col",), numpy.arange(cols) * COL_PITCH_MM, "mm"),
        "axis": ["x", "y", "z"],
    }
    return xarray.Dataset(variables, coords, attrs=meta)
