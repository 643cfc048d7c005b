"""compare_pictures.py BIN WORK: of each part of the guest test uvc_camera, whether the pictures on
CAMERA are those that the camera sent, and when they came."""
import io
import pathlib
import sys

import numpy
import PIL.Image

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1] / "system"))
import live_log  # noqa: E402

programs, work = (pathlib.Path(word) for word in sys.argv[1:3])
sys.path.insert(0, str(programs.parent / "share" / "gastronaut" / "python"))
from gastronaut import image_t  # noqa: E402

LEAST = 10        # pictures in any part
OUTAGE = 8.0      # seconds from the last picture before trouble to the first behind it
failed = False


def check(condition, what):
    global failed
    print(("ok     " if condition else "FAILED ") + what)
    failed |= not condition


def images(path):
    return [(log_time, image_t.decode(payload)) for log_time, channel, payload in
            live_log.events(path) if channel == "CAMERA"]


pictures = [bytes(image.data) for _, image in images(work / "pictures.lcmlog")]
for name, gaps in (("isochronous", 0), ("bulk", 0), ("damaged", 0), ("silent", 1), ("pulled", 1),
                   ("kernel", 0), ("kernel_pulled", 1), ("taken", 0), ("given_back", 0)):
    sent = [tuple(map(int, line.split())) for line in
            (work / f"{name}.sent").read_text().splitlines()]
    came = images(work / f"{name}.lcmlog")
    # Each picture that came is the next one sent with these bytes; what lies between was lost.
    at, lost, places, latency, offset, strange = 0, 0, [], [], [], 0
    for log_time, image in came:
        place = next((i for i in range(at, len(sent))
                      if pictures[sent[i][1]] == bytes(image.data)), None)
        if place is None:
            strange += 1
            continue
        if places:
            lost += place - at
        at = place + 1
        places.append(place)
        latency.append(1e-3 * (log_time - sent[place][0]))
        offset.append(1e-3 * (image.utime - sent[place][0]))
    times = [log_time * 1e-6 for log_time, _ in came]
    outage = max((b - a for a, b in zip(times, times[1:])), default=0)
    print(f"{name}: {len(sent)} sent, {len(came)} came, {lost} lost between, longest pause "
          f"{outage:.2f} s; begin of sending to recorded, ms: median "
          f"{live_log.percentile(latency, 0.5):.1f}, 99 % {live_log.percentile(latency, 0.99):.1f}; "
          f"utime less begin of exposure, ms: {min(offset):.1f} to {max(offset):.1f}")
    check(len(came) >= LEAST and strange == 0, "what came is what was sent, bit for bit, in order")
    if gaps == 0:
        check(lost == 0, "nothing was lost between the first and the last")
    else:
        check(places[-1] > 40 and outage < OUTAGE, "pictures come again")



def sent_luma(width, height, number):
    """As test_pictures.hpp makes it."""
    y, x = numpy.mgrid[0:height, 0:width]
    return 128 + 50 * (numpy.sin(0.11 * x + number) * numpy.cos(0.07 * y) + numpy.sin(0.5 * (x - y)))


sent = [tuple(map(int, line.split())) for line in (work / "yuyv.sent").read_text().splitlines()]
came = images(work / "yuyv.lcmlog")
check(len(came) >= LEAST, f"yuyv: {len(sent)} sent, {len(came)} came")
for _, image in came:
    luma = numpy.array(PIL.Image.open(io.BytesIO(bytes(image.data))).convert("YCbCr"))[:, :, 0]
    error = min(abs(luma - sent_luma(image.width, image.height, number)).mean()
                for number in {number for _, number in sent})
    # Quality 95 divides the coefficients by 1 to 10: an error of about a level.
    if error > 2:
        check(False, f"the picture of {image.utime} is off by {error:.1f} levels")
sys.exit(1 if failed else 0)
