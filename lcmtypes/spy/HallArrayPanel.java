package gastronaut.spy;

import gastronaut.hall_array_t;
import gastronaut.magnetic_pose_t;
import gastronaut.rig_config_t;
import java.awt.Dimension;
import java.awt.Graphics2D;
import java.awt.event.MouseAdapter;
import java.awt.event.MouseEvent;
import java.io.IOException;
import java.nio.ByteBuffer;
import java.util.ArrayList;
import java.util.List;
import java.util.regex.Matcher;
import java.util.regex.Pattern;

/**
 * The Hall array from above, x to the right and y up: each sensor's field as a colour, its
 * direction as an arrow, and why a sensor is not used. A click takes the present reading as zero,
 * another click gives the whole field again.
 */
public final class HallArrayPanel extends MessagePanel {
  static final double MICROTESLA = 1e6;
  private static final int MAX_SENSORS = 4096;
  // Bytes before num_sensors (fingerprint, utime, seq), and before the fields.
  private static final int SENSORS_OFFSET = 2 * Long.BYTES + Integer.BYTES;
  private static final int FIELDS_OFFSET = SENSORS_OFFSET + 2 * Integer.BYTES;
  private static final int MAX_FOOTER_SENSORS = 12;
  private static final String LEGEND =
      "From above, x right, y up; dot: field towards you, cross: away";
  private static final Pattern ROWS = Pattern.compile("(?m)^  rows: (\\d{1,4})$");
  private static final Pattern COLUMNS = Pattern.compile("(?m)^  cols: (\\d{1,4})$");

  private volatile hall_array_t reading;
  private volatile hall_array_t zero;
  private volatile magnetic_pose_t pose;
  private volatile int configuredRows = 0;
  private volatile int configuredColumns = 0;

  public HallArrayPanel(String channel) {
    super(channel, 8, new Dimension(520, 525));
    addMouseListener(new MouseAdapter() {
      @Override
      public void mouseClicked(MouseEvent event) {
        toggleZero();
      }
    });
  }

  @Override
  protected List<String> companions() {
    return List.of("RIG_CONFIG", "MAGNETIC_POSE");
  }

  @Override
  protected void decode(byte[] bytes) throws IOException {
    measure(ByteBuffer.wrap(bytes));
    reading = new hall_array_t(bytes);
  }

  @Override
  protected void decodeCompanion(byte[] bytes) throws IOException {
    if (ByteBuffer.wrap(bytes).getLong() == rig_config_t.LCM_FINGERPRINT) {
      readGrid(new rig_config_t(bytes).yaml);
    } else {
      pose = new magnetic_pose_t(bytes);
    }
  }

  /** The generated decoder would first ask for as many arrays as num_sensors says. */
  private static void measure(ByteBuffer message) throws IOException {
    if (message.capacity() < FIELDS_OFFSET) throw new IOException("too short");
    int sensors = message.getInt(SENSORS_OFFSET);
    int axes = message.getInt(SENSORS_OFFSET + Integer.BYTES);
    if (sensors <= 0 || sensors > MAX_SENSORS || axes != 1 && axes != 3) {
      throw new IOException(sensors + " sensors of " + axes + " axes");
    }
    if (message.capacity() != FIELDS_OFFSET + sensors * (axes * Float.BYTES + Integer.BYTES)) {
      throw new IOException(message.capacity() + " bytes for " + sensors + " sensors");
    }
  }

  /** Takes the present reading as zero, or the true zero again. */
  public void toggleZero() {
    zero = zero == null ? reading : null;
    repaint();
  }

  @Override
  protected String summary() {
    hall_array_t shown = reading;
    if (shown == null) return "";
    return "seq " + shown.seq
        + (zero == null ? "   click: take this reading as zero"
                        : "   change since the click; click: whole field");
  }

  @Override
  protected void paintView(Graphics2D graphics, int width, int height) {
    hall_array_t shown = reading;
    if (shown == null) return;
    HallReading field = new HallReading(shown, zero);
    int rows = rows(shown.num_sensors);
    int columns = (shown.num_sensors + rows - 1) / rows;
    int footer = 2 * graphics.getFontMetrics().getHeight() + 6;
    int bar = ColourScale.BAR_WIDTH;
    double cell = Math.min((width - bar) / (double) rows, (height - footer) / (double) columns);
    if (cell < 2) return;
    for (int sensor = 0; sensor < shown.num_sensors; ++sensor) {
      // Sensors are numbered along y first.
      double left = sensor / columns * cell;
      double top = (columns - 1 - sensor % columns) * cell;
      HallCell.paint(graphics, field, sensor, left, top, cell);
    }
    int mapWidth = (int) (rows * cell);
    int mapHeight = (int) (columns * cell);
    ColourScale.paintBar(
        graphics, mapWidth + 12, 0, mapHeight, 0, MICROTESLA * field.strongest(), 1, "\u00b5T");
    paintSensorsNotUsed(graphics, field, mapHeight);
    paintLegend(graphics, mapHeight + footer / 2);
  }

  private void readGrid(String yaml) {
    String array = yaml.substring(Math.max(0, yaml.indexOf("hall_array:")));
    configuredRows = number(ROWS.matcher(array));
    configuredColumns = number(COLUMNS.matcher(array));
  }

  private static int number(Matcher matcher) {
    return matcher.find() ? Integer.parseInt(matcher.group(1)) : 0;
  }

  private int rows(int sensors) {
    if (configuredRows * configuredColumns == sensors && configuredRows > 0) return configuredRows;
    return (int) Math.ceil(Math.sqrt(sensors));
  }

  private static void paintSensorsNotUsed(Graphics2D graphics, HallReading field, int top) {
    List<String> unused = new ArrayList<>();
    int count = 0;
    for (int sensor = 0; sensor < field.sensors(); ++sensor) {
      String cause = field.cause(sensor);
      if (cause.isEmpty()) continue;
      if (++count <= MAX_FOOTER_SENSORS) unused.add(sensor + " " + cause);
    }
    String text = count == 0 ? "all " + field.sensors() + " sensors good"
                             : count + " of " + field.sensors() + " not used: "
            + String.join(", ", unused) + (count > MAX_FOOTER_SENSORS ? ", ..." : "");
    graphics.setFont(Theme.FONT);
    graphics.setColor(count == 0 ? Theme.FAINT : Theme.BAD);
    graphics.drawString(text, 0, top + graphics.getFontMetrics().getAscent() + 4);
  }

  /** Which sensors the localizer leaves out is not on the bus, but how many channels it uses is. */
  private void paintLegend(Graphics2D graphics, int top) {
    magnetic_pose_t last = pose;
    graphics.setFont(Theme.SMALL);
    graphics.setColor(Theme.FAINT);
    String text = LEGEND;
    if (last != null) {
      if (last.status != magnetic_pose_t.STATUS_OK) graphics.setColor(Theme.FAIR);
      text = "localizer: " + poseStatus(last.status) + ", uses " + last.num_channels_used
          + " channels.   " + text;
    }
    graphics.drawString(text, 0, top + graphics.getFontMetrics().getAscent() + 4);
  }

  private static String poseStatus(int status) {
    switch (status) {
      case magnetic_pose_t.STATUS_OK:
        return "ok";
      case magnetic_pose_t.STATUS_NO_FIX:
        return "no fix";
      case magnetic_pose_t.STATUS_TOO_FAR:
        return "too far";
      case magnetic_pose_t.STATUS_INTERFERENCE:
        return "interference";
      case magnetic_pose_t.STATUS_SATURATED:
        return "saturated";
      case magnetic_pose_t.STATUS_NO_CURRENTS:
        return "no coil currents";
      default:
        return "status " + status;
    }
  }
}
