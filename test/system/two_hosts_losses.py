"""two_hosts_losses.py BIN RAW LOSSY: what the recording lacks of the raw log is what the processes
counted as lost, and they counted something."""
import pathlib
import sys

import live_log

programs = pathlib.Path(sys.argv[1])
sys.path.insert(0, str(programs.parent / "share" / "gastronaut" / "python"))
from gastronaut import process_status_t  # noqa: E402

utimes, last = [{}, {}], {}
for kind, path in enumerate(sys.argv[2:4]):
    for _, channel, payload in live_log.events(pathlib.Path(path)):
        utimes[kind].setdefault(channel, set()).add(live_log.message_utime(payload))
        if kind == 1 and channel == "PROCESS_STATUS":
            status = process_status_t.decode(payload)
            last[status.name] = status


def gaps(channel):
    """Of what was sent between the first and the last that arrived: a gap needs both its ends."""
    sent, came = utimes[0][channel], utimes[1][channel]
    return sum(min(came) < utime < max(came) for utime in sent - came)


lost = {channel: gaps(channel) for channel in ("HALL_ARRAY", "COIL_CURRENTS", "CAMERA")}
print("missing in the recording:", lost)
failed = False
for name, expected in (("magnetic_localizer", lost["HALL_ARRAY"] + lost["COIL_CURRENTS"]),
                       ("depth_estimator", lost["CAMERA"])):
    good = last[name].lost == expected > 0
    failed |= not good
    print(f"{'ok    ' if good else 'FAILED'} {name} counted {last[name].lost} of {expected}; "
          f"'{last[name].message}'")
sys.exit(1 if failed else 0)
