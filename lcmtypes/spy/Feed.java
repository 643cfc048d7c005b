package gastronaut.spy;

import java.io.IOException;
import java.util.ArrayDeque;
import java.util.ArrayList;
import java.util.List;
import java.util.regex.Pattern;
import javax.swing.Timer;
import lcm.lcm.LCM;
import lcm.lcm.LCMDataInputStream;
import lcm.lcm.LCMSubscriber;

/**
 * Brings the bus's messages to a panel from construction to close(). LCM's thread only queues them;
 * a thread of its own decodes; the event thread repaints at most 30 times a second. When the panel
 * cannot keep up the oldest waiting messages are skipped.
 */
final class Feed implements LCMSubscriber {
  private static final int REPAINT_MILLISECONDS = 34;
  private static final int SILENCE_MILLISECONDS = 500;  // the title's "no message for" must move

  private record Message(boolean own, byte[] bytes) {}

  private final MessagePanel panel;
  private final MessageRate rate;
  private final int backlog;
  private final ArrayDeque<Message> waiting = new ArrayDeque<>();
  private final List<String> patterns = new ArrayList<>();
  private final Thread decoder = new Thread(this::decodeMessages, "decoder");
  private final Timer repainter = new Timer(REPAINT_MILLISECONDS, event -> repaintIfChanged());
  private volatile boolean changed = true;
  private int ticksSinceRepaint = 0;

  Feed(MessagePanel panel, int backlog, MessageRate rate) {
    this.panel = panel;
    this.backlog = backlog;
    this.rate = rate;
    patterns.add(Pattern.quote(panel.channel()));
    for (String companion : panel.companions()) patterns.add(Pattern.quote(companion));
    decoder.setDaemon(true);
    decoder.start();
    repainter.start();
    for (String pattern : patterns) Bus.get().subscribe(pattern, this);
  }

  void close() {
    for (String pattern : patterns) Bus.get().unsubscribe(pattern, this);
    repainter.stop();
    decoder.interrupt();
  }

  @Override
  public void messageReceived(LCM bus, String channel, LCMDataInputStream stream) {
    try {
      byte[] message = new byte[stream.available()];
      stream.readFully(message);
      boolean own = channel.equals(panel.channel());
      if (own) rate.arrived();
      enqueue(new Message(own, message));
    } catch (IOException impossible) {
      throw new AssertionError("a read from memory failed", impossible);
    }
  }

  private synchronized void enqueue(Message message) {
    if (waiting.size() >= backlog) waiting.removeFirst();
    waiting.addLast(message);
    notifyAll();
  }

  private synchronized Message nextMessage() throws InterruptedException {
    while (waiting.isEmpty()) wait();
    return waiting.removeFirst();
  }

  private void decodeMessages() {
    try {
      while (true) {
        Message message = nextMessage();
        if (message.own()) {
          panel.show(message.bytes());
        } else {
          panel.showCompanion(message.bytes());
        }
        changed = true;
      }
    } catch (InterruptedException closed) {
      // close() ends the thread.
    }
  }

  private void repaintIfChanged() {
    ++ticksSinceRepaint;
    if (!changed && ticksSinceRepaint * REPAINT_MILLISECONDS < SILENCE_MILLISECONDS) return;
    changed = false;
    ticksSinceRepaint = 0;
    panel.repaint();
  }
}
