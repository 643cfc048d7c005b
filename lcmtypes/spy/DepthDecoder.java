package gastronaut.spy;

import gastronaut.depth_image_t;
import java.awt.image.Raster;
import java.io.IOException;

/** Turns depth_image_t into metres; throws IOException with the reason when it is damaged. */
final class DepthDecoder {
  private DepthDecoder() {}

  /** Row-major depths in metres, NaN where there is none. */
  static float[] decode(depth_image_t message) throws IOException {
    PictureDecoder.checkSize(message.width, message.height);
    if (!(message.metres_per_count > 0) || Double.isInfinite(message.metres_per_count)) {
      throw new IOException("metres_per_count is " + message.metres_per_count);
    }
    int pixels = message.width * message.height;
    switch (message.encoding) {
      case depth_image_t.ENCODING_RAW:
        return metres(message.data, pixels, message.metres_per_count);
      case depth_image_t.ENCODING_ZSTD:
        return metres(
            Zstandard.decompress(message.data, 2 * pixels), pixels, message.metres_per_count);
      case depth_image_t.ENCODING_PNG:
        return metres(PictureDecoder.readRaster("png", message.data, message.width, message.height),
            pixels, message.metres_per_count);
      default:
        throw new IOException("unknown depth encoding " + message.encoding);
    }
  }

  private static float[] metres(byte[] littleEndian, int pixels, double metresPerCount)
      throws IOException {
    if (littleEndian.length != 2 * pixels) {
      throw new IOException(littleEndian.length + " bytes of depth instead of " + 2 * pixels);
    }
    float[] depth = new float[pixels];
    for (int i = 0; i < pixels; ++i) {
      int count = littleEndian[2 * i] & 0xff | (littleEndian[2 * i + 1] & 0xff) << 8;
      depth[i] = metres(count, metresPerCount);
    }
    return depth;
  }

  private static float[] metres(Raster picture, int pixels, double metresPerCount)
      throws IOException {
    if (picture.getNumBands() != 1 || picture.getSampleModel().getSampleSize(0) != 16) {
      throw new IOException("depth PNG without 16 bit grey values");
    }
    int[] counts =
        picture.getSamples(0, 0, picture.getWidth(), picture.getHeight(), 0, new int[pixels]);
    float[] depth = new float[pixels];
    for (int i = 0; i < pixels; ++i) depth[i] = metres(counts[i], metresPerCount);
    return depth;
  }

  private static float metres(int count, double metresPerCount) {
    return count == 0 ? Float.NaN : (float) (count * metresPerCount);
  }
}
