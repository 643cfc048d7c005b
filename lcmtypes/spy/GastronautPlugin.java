package gastronaut.spy;

import java.awt.Window;
import java.awt.event.ActionEvent;
import java.beans.PropertyVetoException;
import javax.swing.AbstractAction;
import javax.swing.Action;
import javax.swing.JDesktopPane;
import javax.swing.JFrame;
import javax.swing.JInternalFrame;
import javax.swing.SwingUtilities;
import lcm.spy.ChannelData;
import lcm.spy.SpyPlugin;

/** lcm-spy finds this class in the jar and offers its action on the channels it can show. */
public final class GastronautPlugin implements SpyPlugin {
  @Override
  public boolean canHandle(long fingerprint) {
    return MessagePanels.canShow(fingerprint);
  }

  @Override
  public Action getAction(JDesktopPane desktop, ChannelData channel) {
    return new AbstractAction("gastronaut view") {
      @Override
      public void actionPerformed(ActionEvent event) {
        open(desktop, channel);
      }
    };
  }

  private static void open(JDesktopPane desktop, ChannelData channel) {
    MessagePanel panel = MessagePanels.create(channel.fingerprint, channel.name);
    Window window = SwingUtilities.getWindowAncestor(desktop);
    JInternalFrame frame = new JInternalFrame(channel.name, true, false, true);
    frame.setContentPane(panel);
    desktop.add(frame);
    if (window instanceof JFrame) {
      // lcm-spy would only hide the window, and its view would go on decoding.
      ((JFrame) window).setDefaultCloseOperation(JFrame.DISPOSE_ON_CLOSE);
      desktop.setPreferredSize(frame.getPreferredSize());
      window.pack();
    }
    frame.setSize(frame.getPreferredSize());
    frame.setVisible(true);
    try {
      frame.setMaximum(true);
    } catch (PropertyVetoException refused) {
      // The view stays at its own size.
    }
  }
}
