package gastronaut.spy;

import com.sun.jna.Library;
import com.sun.jna.Native;
import java.io.IOException;

/** Zstandard decompression by the system's own libzstd: the JDK has none. */
final class Zstandard {
  /** libzstd's C functions, under their own names. */
  public interface Functions extends Library {
    long ZSTD_decompress(byte[] to, long capacity, byte[] from, long size);

    long ZSTD_getFrameContentSize(byte[] from, long size);
  }

  private static Functions functions;

  private Zstandard() {}

  /** Throws when the frame does not hold exactly the given number of bytes. */
  static byte[] decompress(byte[] frame, int size) throws IOException {
    Functions library = load();
    byte[] content = new byte[size];
    if (library.ZSTD_getFrameContentSize(frame, frame.length) != size
        || library.ZSTD_decompress(content, size, frame, frame.length) != size) {
      throw new IOException("Zstandard frame without " + size + " bytes");
    }
    return content;
  }

  private static synchronized Functions load() throws IOException {
    try {
      if (functions == null) functions = Native.load("zstd", Functions.class);
      return functions;
    } catch (LinkageError missing) {
      throw new IOException("libzstd or JNA is missing; run scripts/install_dependencies", missing);
    }
  }
}
