"""A joystick for tests with a clock of their own."""

TOGGLE, EMERGENCY, TAKEOFF_LAND, UP, DOWN, SHUT_DOWN = 0, 2, 6, 9, 10, 7  # Appendix C


class JoystickDesk:
    """Joystick of a desk with a `pilot`, a clock `now_s` and `take`, which carries out orders."""

    message = None  # the newest one of the joystick, (buttons, axes); None: it is not there

    def joy(self, *down, axes=(0.0,) * 8):
        """Send one message with these buttons down."""
        self.message = [1 if i in down else 0 for i in range(11)], axes
        return self.repeat()

    def repeat(self):
        """Send the newest message once more."""
        return self.take(self.pilot.on_joy(*self.message, self.now_s))

    def press(self, button):
        """Press a button, and let go."""
        orders = self.joy(button)
        self.joy()
        return orders
