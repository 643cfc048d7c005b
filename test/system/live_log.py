"""What the tests of live running read from a recording of lcm-logger."""
import struct

SYNC = b"\xed\xa1\xda\x01"


def events(path):
    """(log time, channel, payload) of every whole event; times in microseconds."""
    data = path.read_bytes()
    offset = 0
    while offset + 28 <= len(data):
        sync, _, utime, channel_size, size = struct.unpack_from(">4sqqii", data, offset)
        if sync != SYNC or offset + 28 + channel_size + size > len(data):
            return
        start = offset + 28
        channel = data[start:start + channel_size].decode()
        if channel != "LCM_SELF_TEST":  # which LCM sends itself at its start
            yield utime, channel, data[start + channel_size:start + channel_size + size]
        offset = start + channel_size + size


def message_utime(payload):
    """Every type begins with it, behind the fingerprint."""
    return struct.unpack_from(">q", payload, 8)[0]


def percentile(values, share):
    values = sorted(values)
    return values[int(share * (len(values) - 1))] if values else float("nan")
