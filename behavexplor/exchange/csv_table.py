"""Traces as CSV tables, for spreadsheets and data frames."""

import codecs
import csv
from pathlib import Path
from typing import Final

import numpy as np

from behavexplor.data.durable import new_file
from behavexplor.data.scenario import Scenario
from behavexplor.data.trace import Trace
from behavexplor.exchange.axes import DIGITS, mirrored, mirrored_points
from behavexplor.exchange.scenes import vehicle_name, vehicle_type

COLUMNS: Final = ("time", "vehicle", "type", "x", "y", "heading", "vx", "vy", "length", "width")


def write_table(scenario: Scenario, trace: Trace, path: Path) -> None:
    """Write a trace as a table with the columns `COLUMNS`: one row for each frame and vehicle present in it."""
    pose = mirrored(np.concatenate([trace.position, trace.heading[..., None]], axis=2))
    motion = np.concatenate([pose, mirrored_points(trace.velocity)], axis=2)
    motion = np.round(motion, DIGITS) + 0.0  # no negative zeros
    present = trace.present if trace.present.size else np.ones(trace.heading.shape, dtype=bool)
    names = [(vehicle_name(i), vehicle_type(scenario, i)) for i in range(len(trace.size))]
    sizes, times = trace.size.tolist(), np.round(trace.time, DIGITS).tolist()
    with new_file(path) as file:
        writer = csv.writer(codecs.getwriter("utf-8")(file))
        writer.writerow(COLUMNS)
        for frame, i in np.argwhere(present).tolist():
            writer.writerow([times[frame], *names[i], *motion[frame, i].tolist(), *sizes[i]])
