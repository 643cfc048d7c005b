"""What run_live and doctor share: where the programs lie, what the units are told, and PROCESS_STATUS
off the network.

LCM's Python bindings are in no Debian package; for one small message a second its UDP format
(lcm-proj.github.io, "UDP Multicast Protocol Description") is quickly read.
"""
import os
import pathlib
import shlex
import socket
import struct
import sys
import urllib.parse

DEFAULT_URL = "udpm://239.255.76.67:7667?ttl=0&recv_buf_size=33554432"
DRIVERS = ["can_hall_array", "uvc_camera"]
PROCESSING = ["magnetic_localizer", "depth_estimator", "visual_slam", "sensor_fusion",
              "occupancy_mapper"]
STATES = ["starting", "running", "DEGRADED", "FAILED"]

ETC = pathlib.Path("/etc/gastronaut")
HERE = pathlib.Path(__file__).resolve().parent


def program_folder(build="release"):
    """Of an installed package: this folder; of a clone: the build's."""
    if (HERE / "sensor_fusion").exists():
        return HERE
    return HERE.parent / "build" / build / "bin"


def read_environment(folder=ETC):
    """The assignments of the folder's gastronaut.env; none when it is not there."""
    values, path = {}, pathlib.Path(folder) / "gastronaut.env"
    if path.exists():
        for line in path.read_text().splitlines():
            name, equals, value = line.strip().partition("=")
            if equals and not name.startswith("#"):
                values[name] = " ".join(shlex.split(value))
    return values


def import_status_type(programs):
    """The class process_status_t, which lcm-gen wrote into the build or the package."""
    sys.path.insert(0, str(programs.parent / "share" / "gastronaut" / "python"))
    try:
        from gastronaut import process_status_t
    except ImportError:
        sys.exit(f"no Python types in {sys.path[0]}: build with scripts/build, or install the "
                 "package gastronaut")
    return process_status_t


class Multicast:
    """An LCM URL udpm://GROUP:PORT?ttl=T&recv_buf_size=B."""

    def __init__(self, url):
        parts = urllib.parse.urlsplit(url)
        options = dict(urllib.parse.parse_qsl(parts.query))
        if parts.scheme != "udpm":
            raise ValueError(f"'{url}' is not of the form {DEFAULT_URL}")
        self.group = parts.hostname or "239.255.76.67"
        self.port = parts.port or 7667
        self.ttl = int(options.get("ttl", 0))
        self.receive_buffer = int(options.get("recv_buf_size", 0))

    def open(self):
        """A socket that hears the group."""
        listener = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        for option in (socket.SO_REUSEADDR, socket.SO_REUSEPORT):
            listener.setsockopt(socket.SOL_SOCKET, option, 1)
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, self.receive_buffer or 1 << 21)
        listener.bind((self.group, self.port))
        membership = struct.pack("4s4s", socket.inet_aton(self.group), socket.inet_aton("0.0.0.0"))
        listener.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, membership)
        return listener


def read_status(packet, status_type):
    """The PROCESS_STATUS in an LCM packet, or None."""
    channel = b"PROCESS_STATUS\0"
    if packet[:4] != b"LC02" or packet[8:8 + len(channel)] != channel:
        return None
    try:
        return status_type.decode(packet[8 + len(channel):])
    except (ValueError, struct.error):
        return None


def default_url(environment):
    """This shell's LCM_DEFAULT_URL, else gastronaut.env's."""
    return (os.environ.get("LCM_DEFAULT_URL") or environment.get("LCM_DEFAULT_URL") or
            DEFAULT_URL)
