"""Recordings (ROS bags) as a physical car writes them."""

import sqlite3
from collections.abc import Mapping, Sequence
from contextlib import closing
from pathlib import Path

from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

LAYOUTS = {
    "deepracer_interfaces_pkg/msg/ServoCtrlMsg": "float32 angle\nfloat32 throttle\n"
    "builtin_interfaces/Time source_stamp\n",
    "deepracer_interfaces_pkg/msg/DeviceStatusMsg": "".join(
        f"float32 {name}\n"
        for name in (
            *("cpu_percent", "cpu_temp", "cpu_freq", "cpu_freq_max", "memory_usage"),
            *("free_disk", "latency_mean", "latency_p95", "fps_mean"),
        )
    ),
}
OLD_SERVO = {"deepracer_interfaces_pkg/msg/ServoCtrlMsg": "float32 angle\nfloat32 throttle\n"}


def record(
    folder: Path,
    late_ms: Sequence[float],
    *,
    status: Sequence[tuple[float, float]] = (),
    layouts: Mapping[str, str] = LAYOUTS,
    storage: StoragePlugin = StoragePlugin.SQLITE3,
    embedded: bool = True,
) -> Path:
    """Write a recording as the car does: an action every 33 ms, so late after its picture.

    ROS before Jazzy does not embed the layout of messages.
    """
    store = get_typestore(Stores.ROS2_HUMBLE)
    for name, layout in layouts.items():
        store.register(get_types_from_msg(layout, name))
    servo, device = "deepracer_interfaces_pkg/msg/ServoCtrlMsg", [*LAYOUTS][1]
    time_of = store.types["builtin_interfaces/msg/Time"]
    begin_ns = 1_790_000_000_000_000_000
    with Writer(folder, version=9, storage_plugin=storage) as bag:
        known = {"typestore": store}
        actions = bag.add_connection("/deepracer_navigation_pkg/auto_drive", servo, **known)
        for k, ms in enumerate(late_ms):
            taken_ns = begin_ns + k * 33_000_000
            values = [0.1, 0.5]
            if layouts is LAYOUTS:
                values.append(time_of(taken_ns // 10**9, taken_ns % 10**9))
            message = store.serialize_cdr(store.types[servo](*values), servo)
            bag.write(actions, taken_ns + int(ms * 1e6), message)
        if status:
            told = bag.add_connection("/device_info_pkg/device_status", device, **known)
        for mean, slow in status:
            message = store.types[device](10, 50, 1800, 2400, 40, 60, mean, slow, 30)
            bag.write(told, begin_ns, store.serialize_cdr(message, device))
    if not embedded:
        with closing(sqlite3.connect(next(folder.glob("*.db3")))) as database, database:
            database.execute("DELETE FROM message_definitions")
    return folder
