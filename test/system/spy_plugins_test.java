// lcm-spy's views painted off the screen from messages of known content, and fed damage.
// usage: java -cp gastronaut_lcmtypes.jar:lcm.jar:jna.jar spy_plugins_test.java

import gastronaut.capsule_state_t;
import gastronaut.depth_image_t;
import gastronaut.hall_array_t;
import gastronaut.image_metadata_t;
import gastronaut.image_t;
import gastronaut.pose_t;
import gastronaut.process_status_t;
import gastronaut.sensor_health_t;
import gastronaut.spy.CapsuleStatePanel;
import gastronaut.spy.DepthPanel;
import gastronaut.spy.GastronautPlugin;
import gastronaut.spy.HallArrayPanel;
import gastronaut.spy.MessagePanel;
import gastronaut.spy.MessagePanels;
import gastronaut.spy.PicturePanel;
import gastronaut.spy.ProcessStatusPanel;
import java.awt.Color;
import java.awt.Graphics2D;
import java.awt.geom.Point2D;
import java.awt.image.BufferedImage;
import java.io.ByteArrayOutputStream;
import java.io.File;
import java.io.IOException;
import java.nio.ByteBuffer;
import java.nio.ByteOrder;
import java.util.Arrays;
import java.util.LinkedHashMap;
import java.util.Map;
import java.util.Random;
import java.util.function.IntPredicate;
import javax.imageio.ImageIO;
import lcm.lcm.LCMDataOutputStream;
import lcm.lcm.LCMEncodable;

class SpyPluginsTest {
  static final int WIDTH = 700;  // of the painted panels
  static final int HEIGHT = 500;
  // The views' colours that carry meaning: ends of the colour scale, alarm, all well, no depth.
  static final int HIGHEST = 0xfde725;
  static final int LOWEST = 0x440154;
  static final int ALARM = 0xf0655a;
  static final int GOOD = 0x5fbf77;
  static final int NO_DEPTH = 0x808080;
  static final int JPEG_ERROR = 6;  // grey levels, flat colour at ImageIO's quality of 0.75
  static final double HALF_A_CELL = 0.5;
  static final int PATH_COLOURS = 24;  // grey levels: a path fades gradually
  static final int FLIPS = 300;  // damaged messages of each kind
  static final long SECOND = 1_000_000;  // microseconds

  static final int CELLS_WIDTH = 455;  // of the array's map: square cells fill the panel's height
  static final int DEPTH_WIDTH = 80;  // pixels
  static final int DEPTH_HEIGHT = 60;

  interface Test {
    void run() throws Exception;
  }

  public static void main(String[] arguments) {
    System.setProperty("java.awt.headless", "true");
    Map<String, Test> tests = new LinkedHashMap<>();
    tests.put("ViewsAreOfferedForTheirTypesOnly", SpyPluginsTest::viewsAreOffered);
    tests.put("GreyPictureKeepsItsLevels", SpyPluginsTest::greyPicture);
    tests.put("ColourOrderOfRgbAndBgrIsKept", SpyPluginsTest::colourOrder);
    tests.put("MjpegIsShownWithAndWithoutHuffmanTables", SpyPluginsTest::mjpeg);
    tests.put("PictureThatContradictsItselfIsSaidInText", SpyPluginsTest::wrongPictures);
    tests.put("NearDepthIsYellowFarIsVioletNoneIsGrey", SpyPluginsTest::depthColours);
    tests.put("DepthLooksTheSameInEveryEncoding", SpyPluginsTest::depthEncodings);
    tests.put("DepthThatContradictsItselfIsSaidInText", SpyPluginsTest::wrongDepth);
    tests.put("HottestCellIsOverTheDipole", SpyPluginsTest::hottestCell);
    tests.put("ArrowPointsAlongTheField", SpyPluginsTest::arrowDirection);
    tests.put("UnusedSensorsAreMarkedAndDoNotSetTheScale", SpyPluginsTest::unusedSensors);
    tests.put("ReadingTakenAsZeroLeavesTheChange", SpyPluginsTest::zeroedReading);
    tests.put("FailedSensorTurnsTheCapsuleViewRed", SpyPluginsTest::sensorHealth);
    tests.put("PathFromAboveHasXToTheRight", SpyPluginsTest::pathFromAbove);
    tests.put("PositionThatIsNoNumberIsSaidInText", SpyPluginsTest::capsuleWithoutNumbers);
    tests.put("LogPlayedAgainStartsANewHistory", SpyPluginsTest::timeRunsBackwards);
    tests.put("FailedProcessIsRedRunningIsGreen", SpyPluginsTest::processStates);
    tests.put("ProcessTableDoesNotGrowWithoutEnd", SpyPluginsTest::manyProcesses);
    tests.put("DamagedMessagesNeverThrow", SpyPluginsTest::damage);
    int failed = 0;
    for (Map.Entry<String, Test> test : tests.entrySet()) {
      long start = System.nanoTime();
      try {
        test.getValue().run();
        System.out.printf(
            "ok      %s, %.1f s%n", test.getKey(), 1e-9 * (System.nanoTime() - start));
      } catch (Throwable problem) {
        ++failed;
        System.out.println("FAILED  " + test.getKey());
        problem.printStackTrace(System.out);
      }
    }
    System.exit(failed == 0 ? 0 : 1);
  }

  // --- the tests

  static void viewsAreOffered() {
    GastronautPlugin plugin = new GastronautPlugin();
    for (long fingerprint : new long[] {image_t.LCM_FINGERPRINT, depth_image_t.LCM_FINGERPRINT,
             hall_array_t.LCM_FINGERPRINT, capsule_state_t.LCM_FINGERPRINT,
             process_status_t.LCM_FINGERPRINT}) {
      check(plugin.canHandle(fingerprint), "a type without its view");
    }
    check(!plugin.canHandle(pose_t.LCM_FINGERPRINT), "a view for pose_t");
  }

  static void greyPicture() throws Exception {
    byte[] levels = new byte[40 * 30];
    Arrays.fill(levels, (byte) 200);
    PicturePanel panel = new PicturePanel("ALBEDO");
    show(panel, picture(40, 30, 40, image_t.PIXEL_FORMAT_GRAY, levels));
    checkEqual(0xc8c8c8, centre(panel), "a grey picture's pixel");
  }

  static void colourOrder() throws Exception {
    byte[] samples = new byte[3 * 16];
    for (int i = 0; i < samples.length; i += 3) samples[i] = (byte) 255;
    PicturePanel panel = new PicturePanel("CAMERA");
    show(panel, picture(4, 4, 12, image_t.PIXEL_FORMAT_RGB, samples));
    checkEqual(0xff0000, centre(panel), "RGB's first sample");
    show(panel, picture(4, 4, 12, image_t.PIXEL_FORMAT_BGR, samples));
    checkEqual(0x0000ff, centre(panel), "BGR's first sample");
  }

  static void mjpeg() throws Exception {
    byte[] file = jpeg(64, 48, new Color(40, 160, 90));
    for (byte[] data : new byte[][] {file, withoutHuffmanTables(file)}) {
      PicturePanel panel = new PicturePanel("CAMERA");
      show(panel, picture(64, 48, 0, image_t.PIXEL_FORMAT_MJPEG, data));
      Color shown = new Color(centre(panel));
      int error = Math.max(Math.abs(shown.getRed() - 40),
          Math.max(Math.abs(shown.getGreen() - 160), Math.abs(shown.getBlue() - 90)));
      check(error <= JPEG_ERROR, "JPEG colour off by " + error);
    }
  }

  static void wrongPictures() throws Exception {
    byte[] levels = new byte[100];
    byte[] file = jpeg(64, 48, Color.GREEN);
    checkRefused(new PicturePanel("P"), picture(0, 0, 0, image_t.PIXEL_FORMAT_GRAY, levels));
    checkRefused(new PicturePanel("P"), picture(-5, 10, 10, image_t.PIXEL_FORMAT_GRAY, levels));
    checkRefused(new PicturePanel("P"), picture(10, 11, 10, image_t.PIXEL_FORMAT_GRAY, levels));
    checkRefused(new PicturePanel("P"), picture(10, 10, 9, image_t.PIXEL_FORMAT_GRAY, levels));
    checkRefused(new PicturePanel("P"), picture(10, 10, 10, image_t.PIXEL_FORMAT_RGB, levels));
    checkRefused(new PicturePanel("P"),
        picture(Integer.MAX_VALUE, Integer.MAX_VALUE, Integer.MAX_VALUE, image_t.PIXEL_FORMAT_GRAY,
            levels));
    checkRefused(new PicturePanel("P"), picture(10, 10, 10, 7, levels));
    checkRefused(new PicturePanel("P"), picture(65, 48, 0, image_t.PIXEL_FORMAT_MJPEG, file));
    checkRefused(new PicturePanel("P"), picture(64, 48, 0, image_t.PIXEL_FORMAT_MJPEG, levels));
    checkRefused(
        new PicturePanel("P"), picture(64, 48, 0, image_t.PIXEL_FORMAT_MJPEG, new byte[0]));
    image_t lying = picture(10, 10, 10, image_t.PIXEL_FORMAT_GRAY, levels);
    byte[] bytes = encode(lying);
    // The member size, after fingerprint, utime and four int32, claims two gigabytes.
    ByteBuffer.wrap(bytes).putInt(8 + 8 + 16, Integer.MAX_VALUE);
    checkRefused(new PicturePanel("P"), bytes);
  }

  static void depthColours() throws Exception {
    DepthPanel panel = new DepthPanel("DEPTH");
    show(panel, depth(depth_image_t.ENCODING_RAW, counts()));
    BufferedImage painted = paint(panel);
    double near = centroid(painted, 0, pixel -> pixel == HIGHEST).getX();
    // The bar at the right also ends in violet, so the picture is taken up to three quarters.
    double far = centroid(painted, WIDTH / 4, pixel -> pixel == LOWEST).getX();
    check(near < far, "the near side is not left of the far side");
    check(count(painted, pixel -> pixel == NO_DEPTH) > 0, "holes are not grey");
  }

  static void depthEncodings() throws Exception {
    byte[] raw = counts();
    BufferedImage expected =
        paint(shown(new DepthPanel("D"), depth(depth_image_t.ENCODING_RAW, raw)));
    checkSame(expected,
        paint(shown(new DepthPanel("D"), depth(depth_image_t.ENCODING_ZSTD, zstandard(raw)))),
        "Zstandard");
    checkSame(expected,
        paint(shown(new DepthPanel("D"), depth(depth_image_t.ENCODING_PNG, png(raw)))), "PNG");
  }

  static void wrongDepth() throws Exception {
    checkRefused(new DepthPanel("D"), depth(depth_image_t.ENCODING_RAW, new byte[7]));
    checkRefused(new DepthPanel("D"), depth(depth_image_t.ENCODING_ZSTD, new byte[7]));
    checkRefused(new DepthPanel("D"), depth(depth_image_t.ENCODING_ZSTD, zstandard(new byte[4])));
    checkRefused(new DepthPanel("D"), depth(depth_image_t.ENCODING_PNG, new byte[7]));
    checkRefused(new DepthPanel("D"), depth((byte) 9, counts()));
    depth_image_t message = depth(depth_image_t.ENCODING_RAW, counts());
    message.metres_per_count = Double.NaN;
    checkRefused(new DepthPanel("D"), message);
    depth_image_t empty =
        depth(depth_image_t.ENCODING_RAW, new byte[2 * DEPTH_WIDTH * DEPTH_HEIGHT]);
    show(new DepthPanel("D"), empty);  // no depth anywhere is no damage
  }

  static void hottestCell() throws Exception {
    // The corners' cells tell where the grid is; sensors are numbered along y first, from above.
    Point2D corner = hottest(dipoleUnder(0));
    Point2D up = hottest(dipoleUnder(7));
    Point2D right = hottest(dipoleUnder(56));
    check(up.getY() < corner.getY() && right.getX() > corner.getX(), "x right and y up");
    double cellRight = (right.getX() - corner.getX()) / 7;
    double cellUp = (corner.getY() - up.getY()) / 7;
    for (int sensor : new int[] {0, 18, 42, 63}) {
      Point2D hot = hottest(dipoleUnder(sensor));
      double columns = (hot.getX() - corner.getX()) / cellRight - sensor / 8;
      double rows = (corner.getY() - hot.getY()) / cellUp - sensor % 8;
      check(Math.max(Math.abs(columns), Math.abs(rows)) < HALF_A_CELL,
          "sensor " + sensor + " is off by " + columns + ", " + rows + " cells");
    }
  }

  static void arrowDirection() throws Exception {
    BufferedImage right = paint(shown(new HallArrayPanel("H"), uniform(1, 0)));
    BufferedImage left = paint(shown(new HallArrayPanel("H"), uniform(-1, 0)));
    BufferedImage up = paint(shown(new HallArrayPanel("H"), uniform(0, 1)));
    BufferedImage down = paint(shown(new HallArrayPanel("H"), uniform(0, -1)));
    // On the brightest colour the arrow is black.
    IntPredicate arrow = pixel -> pixel == 0;
    check(centroid(right, 0, arrow).getX() > centroid(left, 0, arrow).getX(), "x");
    check(centroid(up, 0, arrow).getY() < centroid(down, 0, arrow).getY(), "y");
  }

  static void unusedSensors() throws Exception {
    Point2D expected = hottest(dipoleUnder(42));
    hall_array_t reading = dipoleUnder(42);
    check(count(paint(shown(new HallArrayPanel("H"), reading)), p -> p == ALARM) == 0,
        "an alarm for healthy sensors");
    reading.status[3] = hall_array_t.STATUS_STALE;
    reading.status[20] = hall_array_t.STATUS_SATURATED;
    reading.status[50] = hall_array_t.STATUS_FAULT;
    reading.field[20] = new float[] {1, 1, 1};
    reading.field[60][1] = Float.NaN;
    BufferedImage painted = paint(shown(new HallArrayPanel("H"), reading));
    check(centroid(painted, 0, p -> p == ALARM) != null, "no alarm for unused sensors");
    check(hottest(reading).distance(expected) < 1, "an unused sensor is the hottest");
  }

  static void zeroedReading() throws Exception {
    HallArrayPanel panel = new HallArrayPanel("H");
    show(panel, dipoleUnder(10));
    panel.toggleZero();
    hall_array_t next = dipoleUnder(10);
    next.field[45][2] += 1e-6f;
    show(panel, next);
    Point2D change = centroid(paint(panel), 0, p -> p == HIGHEST);
    check(change.distance(hottest(dipoleUnder(45))) < WIDTH / 16.0, "the change is elsewhere");
  }

  static void sensorHealth() throws Exception {
    CapsuleStatePanel panel = new CapsuleStatePanel("CAPSULE_STATE");
    for (int i = 0; i < 100; ++i) show(panel, state(i * SECOND / 10, 0.001 * i, ""));
    check(count(paint(panel), p -> p == ALARM) == 0, "an alarm for healthy sensors");
    for (int i = 100; i < 200; ++i) show(panel, state(i * SECOND / 10, 0.001 * i, "blur"));
    BufferedImage painted = paint(panel);
    Point2D bad = centroid(painted, 0, p -> p == ALARM);
    check(bad != null, "no alarm for a blurred camera");
    check(bad.getX() > centroid(painted, 0, p -> p == GOOD).getX(), "newest is not at the right");
  }

  static void pathFromAbove() throws Exception {
    for (int direction : new int[] {1, -1}) {
      CapsuleStatePanel panel = new CapsuleStatePanel("CAPSULE_STATE");
      for (int i = 0; i < 400; ++i) {
        show(panel, state(i * SECOND / 10, direction * 0.0001 * i, ""));
      }
      BufferedImage painted = paint(panel);
      // The path is coloured by age as heat is: newest brightest. Only the map has these colours.
      Point2D newest = centroid(painted, WIDTH / 2, p -> near(p, HIGHEST));
      Point2D older = centroid(painted, WIDTH / 2, p -> near(p, 0x21918c));
      check(direction * (newest.getX() - older.getX()) > 0, "x is not to the right");
    }
  }

  static void capsuleWithoutNumbers() throws Exception {
    CapsuleStatePanel panel = new CapsuleStatePanel("CAPSULE_STATE");
    show(panel, state(0, 0, ""));
    for (double bad : new double[] {Double.NaN, Double.POSITIVE_INFINITY}) {
      capsule_state_t message = state(SECOND, bad, "");
      message.covariance[1][1] = bad;
      message.orientation[2] = bad;
      message.velocity[0] = bad;
      message.sensors[0].p_nominal = bad;
      checkRefused(panel, message);
    }
    show(panel, state(2 * SECOND, 1e300, ""));
    show(panel, state(3 * SECOND, -1e300, ""));
    paint(panel);
  }

  static void timeRunsBackwards() throws Exception {
    CapsuleStatePanel again = new CapsuleStatePanel("CAPSULE_STATE");
    show(again, state(1000 * SECOND, 1, "blur"));
    show(again, state(Long.MAX_VALUE, 1, "blur"));
    show(again, state(Long.MIN_VALUE, 1, "blur"));
    CapsuleStatePanel fresh = new CapsuleStatePanel("CAPSULE_STATE");
    for (int i = 0; i < 50; ++i) {
      show(again, state(i * SECOND / 10, 0.001 * i, ""));
      show(fresh, state(i * SECOND / 10, 0.001 * i, ""));
      if (i == 0) show(again, state(-SECOND, 7, "blur"));
      if (i == 0) show(again, state(0, 0, ""));
      if (i == 0) show(again, state(-SECOND, 7, ""));
    }
    show(again, state(-2 * SECOND, 0, ""));
    show(fresh, state(-2 * SECOND, 0, ""));
    checkSame(paint(fresh), paint(again), "history after time ran backwards");
  }

  static void processStates() throws Exception {
    ProcessStatusPanel panel = new ProcessStatusPanel("PROCESS_STATUS");
    show(panel, process("depth_estimator", process_status_t.STATE_RUNNING, ""));
    check(count(paint(panel), p -> p == GOOD) > 0, "a running process is not green");
    check(count(paint(panel), p -> p == ALARM) == 0, "a running process is red");
    show(panel, process("can_hall_array", process_status_t.STATE_FAILED, "can0 is down"));
    check(count(paint(panel), p -> p == ALARM) > 0, "a failed process is not red");
  }

  static void manyProcesses() throws Exception {
    ProcessStatusPanel panel = new ProcessStatusPanel("PROCESS_STATUS");
    for (int i = 0; i < 64; ++i) {
      show(panel, process("p" + i, process_status_t.STATE_RUNNING, ""));
    }
    checkRefused(panel, process("one more", process_status_t.STATE_RUNNING, ""));
    show(panel, process("p5", process_status_t.STATE_RUNNING, ""));
  }

  static void damage() throws Exception {
    Random random = new Random(1);
    LCMEncodable[] messages = {
        picture(64, 48, 0, image_t.PIXEL_FORMAT_MJPEG, jpeg(64, 48, Color.ORANGE)),
        picture(10, 10, 10, image_t.PIXEL_FORMAT_GRAY, new byte[100]),
        depth(depth_image_t.ENCODING_ZSTD, zstandard(counts())),
        depth(depth_image_t.ENCODING_PNG, png(counts())), dipoleUnder(12),
        state(SECOND, 0.01, "blur"), process("p", process_status_t.STATE_DEGRADED, "why")};
    for (LCMEncodable message : messages) {
      byte[] good = encode(message);
      MessagePanel panel = MessagePanels.create(ByteBuffer.wrap(good).getLong(), "X");
      for (int i = 0; i < FLIPS; ++i) {
        byte[] bad = Arrays.copyOf(good, i % 2 == 0 ? good.length : random.nextInt(good.length));
        // Half of the damage is in the header, where the sizes are.
        int end = i % 4 < 2 ? bad.length : Math.min(bad.length, 64);
        for (int flip = 0; end > 8 && flip < 3; ++flip) {
          bad[8 + random.nextInt(end - 8)] = (byte) random.nextInt();
        }
        panel.show(bad);
        if (i % 10 == 0) paint(panel);
      }
      paint(panel);
      panel.show(good);
      paint(panel);
    }
  }

  // --- messages

  static image_t picture(int width, int height, int stride, int format, byte[] data) {
    image_t message = new image_t();
    message.width = width;
    message.height = height;
    message.row_stride = stride;
    message.pixelformat = format;
    message.data = data;
    message.size = data.length;
    message.metadata = new image_metadata_t[] {new image_metadata_t()};
    message.metadata[0].key = "seq";
    message.metadata[0].value = "12".getBytes();
    message.metadata[0].n = 2;
    message.nmetadata = 1;
    return message;
  }

  static byte[] jpeg(int width, int height, Color colour) throws IOException {
    BufferedImage picture = new BufferedImage(width, height, BufferedImage.TYPE_INT_RGB);
    Graphics2D graphics = picture.createGraphics();
    graphics.setColor(colour);
    graphics.fillRect(0, 0, width, height);
    graphics.dispose();
    return file("jpeg", picture);
  }

  /** As many USB cameras send it: the standard tables are left out. */
  static byte[] withoutHuffmanTables(byte[] jpeg) {
    ByteArrayOutputStream stripped = new ByteArrayOutputStream();
    stripped.write(jpeg, 0, 2);
    int at = 2;
    while ((jpeg[at + 1] & 0xff) != 0xda) {  // up to the start of scan
      int length = 2 + ((jpeg[at + 2] & 0xff) << 8 | jpeg[at + 3] & 0xff);
      if ((jpeg[at + 1] & 0xff) != 0xc4) stripped.write(jpeg, at, length);
      at += length;
    }
    stripped.write(jpeg, at, jpeg.length - at);
    return stripped.toByteArray();
  }

  static depth_image_t depth(byte encoding, byte[] data) {
    depth_image_t message = new depth_image_t();
    message.width = DEPTH_WIDTH;
    message.height = DEPTH_HEIGHT;
    message.metres_per_count = 1e-5;
    message.relative_std = 0.05;
    message.encoding = encoding;
    message.data = data;
    message.size = data.length;
    return message;
  }

  /** 20 to 40 mm from left to right in four steps, without depth in the uppermost rows. */
  static byte[] counts() {
    ByteBuffer counts = ByteBuffer.allocate(2 * DEPTH_WIDTH * DEPTH_HEIGHT);
    counts.order(ByteOrder.LITTLE_ENDIAN);
    for (int y = 0; y < DEPTH_HEIGHT; ++y) {
      for (int x = 0; x < DEPTH_WIDTH; ++x) {
        counts.putShort((short) (y < 6 ? 0 : 2000 + 500 * (x * 5 / DEPTH_WIDTH)));
      }
    }
    return counts.array();
  }

  /** RFC 8878: a single-segment frame of one raw block. */
  static byte[] zstandard(byte[] content) {
    ByteBuffer frame = ByteBuffer.allocate(12 + content.length).order(ByteOrder.LITTLE_ENDIAN);
    frame.putInt(0xfd2fb528).put((byte) 0xa0).putInt(content.length);
    int header = 1 | content.length << 3;
    frame.put((byte) header).put((byte) (header >> 8)).put((byte) (header >> 16)).put(content);
    return frame.array();
  }

  static byte[] png(byte[] counts) throws IOException {
    BufferedImage picture =
        new BufferedImage(DEPTH_WIDTH, DEPTH_HEIGHT, BufferedImage.TYPE_USHORT_GRAY);
    ByteBuffer values = ByteBuffer.wrap(counts).order(ByteOrder.LITTLE_ENDIAN);
    for (int i = 0; i < counts.length / 2; ++i) {
      picture.getRaster().setSample(
          i % DEPTH_WIDTH, i / DEPTH_WIDTH, 0, values.getShort(2 * i) & 0xffff);
    }
    return file("png", picture);
  }

  static byte[] file(String format, BufferedImage picture) throws IOException {
    ByteArrayOutputStream file = new ByteArrayOutputStream();
    check(ImageIO.write(picture, format, file), format);
    return file.toByteArray();
  }

  /** The field of a vertical dipole of 0.4 A m^2, 60 mm under one sensor of a grid of 22 mm. */
  static hall_array_t dipoleUnder(int sensor) {
    hall_array_t reading = new hall_array_t();
    reading.num_sensors = 64;
    reading.num_axes = 3;
    reading.field = new float[64][3];
    reading.status = new int[64];
    for (int i = 0; i < 64; ++i) {
      double[] r = {0.022 * (i / 8 - sensor / 8), 0.022 * (i % 8 - sensor % 8), 0.06};
      double distance = Math.sqrt(r[0] * r[0] + r[1] * r[1] + r[2] * r[2]);
      for (int axis = 0; axis < 3; ++axis) {
        double value = 3 * 0.4 * r[2] * r[axis] / Math.pow(distance, 5);
        if (axis == 2) value -= 0.4 / Math.pow(distance, 3);
        reading.field[i][axis] = (float) (1e-7 * value);
      }
    }
    return reading;
  }

  static hall_array_t uniform(float x, float y) {
    hall_array_t reading = new hall_array_t();
    reading.num_sensors = 1;
    reading.num_axes = 3;
    reading.field = new float[][] {{1e-4f * x, 1e-4f * y, 0}};
    reading.status = new int[1];
    return reading;
  }

  static capsule_state_t state(long utime, double x, String visualCause) {
    capsule_state_t message = new capsule_state_t();
    message.utime = utime;
    message.status =
        visualCause.isEmpty() ? capsule_state_t.STATUS_NOMINAL : capsule_state_t.STATUS_DEGRADED;
    message.position = new double[] {x, 0.01, 0.02};
    message.orientation = new double[] {1, 0, 0, 0};
    for (int i = 0; i < 6; ++i) message.covariance[i][i] = 1e-8;
    message.depth_scale = 1;
    message.sensors = new sensor_health_t[] {health("magnetic", ""), health("visual", visualCause)};
    message.num_sensors = 2;
    return message;
  }

  static sensor_health_t health(String name, String cause) {
    sensor_health_t health = new sensor_health_t();
    health.name = name;
    health.p_nominal = cause.isEmpty() ? 1 : 0;
    health.alpha = health.p_nominal;
    health.used = cause.isEmpty();
    health.cause = cause;
    return health;
  }

  static process_status_t process(String name, byte state, String message) {
    process_status_t status = new process_status_t();
    status.name = name;
    status.host = "rig";
    status.state = state;
    status.message = message;
    return status;
  }

  // --- painting and checking

  static byte[] encode(LCMEncodable message) throws IOException {
    LCMDataOutputStream stream = new LCMDataOutputStream();
    message.encode(stream);
    return stream.toByteArray();
  }

  static void show(MessagePanel panel, LCMEncodable message) throws IOException {
    panel.show(encode(message));
    check(panel.problem().isEmpty(), panel.problem());
  }

  static MessagePanel shown(MessagePanel panel, LCMEncodable message) throws IOException {
    show(panel, message);
    return panel;
  }

  static void checkRefused(MessagePanel panel, LCMEncodable message) throws IOException {
    checkRefused(panel, encode(message));
  }

  static void checkRefused(MessagePanel panel, byte[] message) {
    panel.show(message);
    check(!panel.problem().isEmpty(), "damage was shown as if it were a message");
    // The reason stands in the alarm's colour in the title line.
    check(count(paint(panel), pixel -> pixel == ALARM) > 0, "no text about the damage");
  }

  static BufferedImage paint(MessagePanel panel) {
    BufferedImage picture = new BufferedImage(WIDTH, HEIGHT, BufferedImage.TYPE_INT_RGB);
    Graphics2D graphics = picture.createGraphics();
    panel.setSize(WIDTH, HEIGHT);
    panel.paint(graphics);
    graphics.dispose();
    return picture;
  }

  static int centre(MessagePanel panel) {
    return paint(panel).getRGB(WIDTH / 2, HEIGHT / 2) & 0xffffff;
  }

  /** Where the brightest cell is; the scale's bar, right of the cells, ends in the same colour. */
  static Point2D hottest(hall_array_t reading) throws IOException {
    BufferedImage painted = paint(shown(new HallArrayPanel("HALL_ARRAY"), reading));
    return centroid(painted.getSubimage(0, 0, CELLS_WIDTH, HEIGHT), 0, p -> p == HIGHEST);
  }

  static Point2D centroid(BufferedImage picture, int left, IntPredicate chosen) {
    double x = 0;
    double y = 0;
    long count = 0;
    for (int row = 0; row < picture.getHeight(); ++row) {
      for (int column = left; column < picture.getWidth(); ++column) {
        if (!chosen.test(picture.getRGB(column, row) & 0xffffff)) continue;
        x += column;
        y += row;
        ++count;
      }
    }
    return count == 0 ? null : new Point2D.Double(x / count, y / count);
  }

  static long count(BufferedImage picture, IntPredicate chosen) {
    return Arrays
        .stream(picture.getRGB(
            0, 0, picture.getWidth(), picture.getHeight(), null, 0, picture.getWidth()))
        .filter(pixel -> chosen.test(pixel & 0xffffff))
        .count();
  }

  static boolean near(int pixel, int colour) {
    for (int shift = 0; shift <= 16; shift += 8) {
      if (Math.abs((pixel >> shift & 0xff) - (colour >> shift & 0xff)) > PATH_COLOURS) return false;
    }
    return true;
  }

  static void checkSame(BufferedImage expected, BufferedImage actual, String what) {
    int[] one = expected.getRGB(0, 0, WIDTH, HEIGHT, null, 0, WIDTH);
    int[] other = actual.getRGB(0, 0, WIDTH, HEIGHT, null, 0, WIDTH);
    check(Arrays.equals(one, other), what + " is painted otherwise");
  }

  static void checkEqual(int expected, int actual, String what) {
    check(expected == actual, what + " is " + Integer.toHexString(actual));
  }

  static void check(boolean condition, String otherwise) {
    if (!condition) throw new AssertionError(otherwise);
  }
}
