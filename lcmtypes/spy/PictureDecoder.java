package gastronaut.spy;

import gastronaut.image_t;
import java.awt.image.BufferedImage;
import java.awt.image.Raster;
import java.io.ByteArrayInputStream;
import java.io.IOException;
import java.util.Iterator;
import javax.imageio.ImageIO;
import javax.imageio.ImageReader;
import javax.imageio.stream.ImageInputStream;

/** Turns image_t into pixels; throws IOException with the reason when the two do not agree. */
final class PictureDecoder {
  private static final long MAX_PIXELS = 1L << 26;

  static {
    // Else every picture goes through a temporary file.
    ImageIO.setUseCache(false);
  }

  private PictureDecoder() {}

  static BufferedImage decode(image_t message) throws IOException {
    checkSize(message.width, message.height);
    switch (message.pixelformat) {
      case image_t.PIXEL_FORMAT_GRAY:
        return uncompressed(message, 1, new int[] {0, 0, 0});
      case image_t.PIXEL_FORMAT_RGB:
        return uncompressed(message, 3, new int[] {0, 1, 2});
      case image_t.PIXEL_FORMAT_BGR:
        return uncompressed(message, 3, new int[] {2, 1, 0});
      case image_t.PIXEL_FORMAT_MJPEG:
        return jpeg(message);
      default:
        throw new IOException("unknown pixel format " + message.pixelformat);
    }
  }

  /** What a JPEG or PNG file holds; its header is compared with the message before its pixels. */
  static Raster readRaster(String format, byte[] file, int width, int height) throws IOException {
    return read(format, file, width, height).getRaster();
  }

  static void checkSize(int width, int height) throws IOException {
    if (width <= 0 || height <= 0 || (long) width * height > MAX_PIXELS) {
      throw new IOException("a picture of " + width + " x " + height + " pixels");
    }
  }

  private static BufferedImage uncompressed(image_t message, int bytesPerPixel, int[] order)
      throws IOException {
    int width = message.width;
    int height = message.height;
    long rowBytes = (long) width * bytesPerPixel;
    if (message.row_stride < rowBytes) {
      throw new IOException("row stride " + message.row_stride + " below the row's " + rowBytes);
    }
    long needed = (height - 1L) * message.row_stride + rowBytes;
    if (message.data.length < needed) {
      throw new IOException(message.data.length + " bytes of picture instead of " + needed);
    }
    BufferedImage picture = new BufferedImage(width, height, BufferedImage.TYPE_INT_RGB);
    int[] row = new int[width];
    for (int y = 0; y < height; ++y) {
      int at = y * message.row_stride;
      for (int x = 0; x < width; ++x, at += bytesPerPixel) {
        row[x] = (message.data[at + order[0]] & 0xff) << 16
            | (message.data[at + order[1]] & 0xff) << 8 | message.data[at + order[2]] & 0xff;
      }
      picture.setRGB(0, y, width, 1, row, 0, width);
    }
    return picture;
  }

  private static BufferedImage jpeg(image_t message) throws IOException {
    return read("jpeg", message.data, message.width, message.height);
  }

  private static BufferedImage read(String format, byte[] file, int width, int height)
      throws IOException {
    Iterator<ImageReader> readers = ImageIO.getImageReadersByFormatName(format);
    if (!readers.hasNext()) throw new IOException("this Java cannot read " + format);
    ImageReader reader = readers.next();
    try (ImageInputStream stream = ImageIO.createImageInputStream(new ByteArrayInputStream(file))) {
      reader.setInput(stream);
      if (reader.getWidth(0) != width || reader.getHeight(0) != height) {
        throw new IOException(String.format("%s of %d x %d pixels in a message of %d x %d", format,
            reader.getWidth(0), reader.getHeight(0), width, height));
      }
      return reader.read(0);
    } finally {
      reader.dispose();
    }
  }
}
