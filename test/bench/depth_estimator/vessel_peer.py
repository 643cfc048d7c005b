"""scikit-image's Frangi filter on the picture that perception_benchmark wrote, same five scales.

usage: vessel_peer.py PICTURE
"""

import sys
import time

import numpy as np

try:
    from skimage.filters import frangi
    from skimage.io import imread
except ImportError:
    sys.exit("NO PEER: python3-skimage is not installed (apt-get install python3-skimage)")

REPETITIONS = 9
picture = imread(sys.argv[1]) / 255.0
for kind in (np.float64, np.float32):
    levels = picture.astype(kind)
    times = []
    for _ in range(REPETITIONS):
        start = time.perf_counter()
        frangi(levels, sigmas=[1, 1.6, 2.5, 4, 6], gamma=0.03, black_ridges=True)
        times.append(time.perf_counter() - start)
    print(f"scikit-image frangi, {kind.__name__}: median {1e3 * np.median(times):.1f} ms, "
          f"least {1e3 * min(times):.1f} ms")
