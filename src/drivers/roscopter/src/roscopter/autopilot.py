"""The bridge's side of the link to one autopilot: a state machine without sockets, clock or ROS.

All inputs carry the time of a monotonic clock: device opened or lost, bytes received, orders given, time passing
(`poll`, every TICK_S). The output is a function that sends bytes.

One vehicle: component 1 of the first system that sends the heartbeat of a vehicle, until the program ends. Other
systems (ground stations, a second vehicle) and other components of the same system (gimbals, cameras, the telemetry
radio) are ignored.
"""

import math

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from roscopter import orders
from roscopter.modes import mode_name, mode_number
from roscopter.streams import Streams
from roscopter.texts import Texts
from roscopter.wire import Encoder, FrameReader, version_of

TICK_S = 0.05  # [s] period of `poll`
HEARTBEAT_S = 1.0  # period of our heartbeat
LOST_S = 3.0  # silence after which the autopilot counts as lost: three heartbeats
PATIENCE_S = 5.0  # until a warning that no vehicle has been heard yet
RELEASES, RELEASE_S = 5, 0.1  # how often, and how far apart, a release of the channels is sent: the radio loses packets
LAST_WORDS = 5  # for the same reason
STOP_S, STOP_PERIOD_S = 2.0, 0.1  # how long and how often motors are ordered to stop
STOPS = 5  # at least, even if a heartbeat reports the vehicle disarmed: an order to arm may still be on its way
REBOOT_MS = 1000  # a reboot is assumed if the time since start falls by more than this
REPEAT_S = 60.0  # until the same warning is repeated
SWITCH_STALE_S = 1.0  # the pilot's switch counts as off when the channels are older
SWITCH_ON_US = 1500
RELEASED, UNCHANGED = 0, 65535  # special values of a channel in RC_CHANNELS_OVERRIDE
_CHANNELS = tuple("chan%d_raw" % k for k in range(1, 9))
_LEAST_US, _MOST_US = 800, 2200
_LEVELS = ((1, "fatal"), (3, "error"), (4, "warn"), (6, "info"), (255, "debug"))  # (STATUSTEXT severity up to, level)
_EVERYONE = (0, 0)  # target system and component
_VEHICLE_COMPONENT = mavlink.MAV_COMP_ID_AUTOPILOT1
_ROVERS = (mavlink.MAV_TYPE_GROUND_ROVER, mavlink.MAV_TYPE_SURFACE_BOAT)
_FAILSAFE_MODE = {"ArduCopter": "LAND", "ArduRover": "HOLD"}


class Autopilot:
    """The logic of one link.

    options: Options.  write: function of bytes, which must not raise.
    report: function (level, text), level "debug", "info", "warn", "error" or "fatal".
    """

    def __init__(self, options, write, report):
        self._options, self._write, self._report = options, write, report
        self._encoder = Encoder(options.source_system, mavlink.MAV_COMP_ID_MISSIONPLANNER)
        self.reader = FrameReader()
        self._texts, self._streams = Texts(), Streams(options.mavlink_rate)

        self.version = 1  # of MAVLink: every autopilot understands 1, and answers in 2 if it can
        self.target = None  # (system, component) of the vehicle
        self.is_open = False  # the device is open
        self.is_connected = False  # the vehicle is heard
        self.is_armed = False
        self.mode = ""
        self.counts = dict.fromkeys(("messages", "lost messages", "reconnects", "reboots", "refused send_rc"), 0)
        self.heartbeat_s = None  # time of the newest heartbeat
        self.is_overriding = False
        self._heard_s = -math.inf
        self._strangers = set()  # systems that are ignored
        self._sequence = None
        self._boot_ms = None

        self._opened_s = math.inf
        self._has_complained = False
        self._next_heartbeat_s = -math.inf
        self._home = (0, 0)  # newest position [1e-7 deg]

        self._order = self._mission = None  # (Order, function of its outcome)
        self._override_s = -math.inf
        self._releases, self._next_release_s = 0, 0.0
        self._switch_s, self._is_switched_on = -math.inf, False
        self._ignoring, self._ignoring_s = "", -math.inf  # last reported reason why send_rc was ignored, and when
        self._has_channels = -math.inf  # time of the last RC_CHANNELS, which includes all of RC_CHANNELS_RAW

        self._fed_s, self._next_watch_s = -math.inf, -math.inf
        self._has_run_out = self._owes_failsafe = False

        self._stop_until_s = self._next_stop_s = -math.inf
        self._stops = 0
        self._heartbeats_before_stop = self._heartbeats = 0

    # --- the link -----------------------------------------------------------------------------------------------------
    def opened(self, now_s):
        """Note that the device was opened."""
        if self._opened_s == math.inf:
            self._fed_s = now_s  # at the first opening only: reopening the device does not feed the watchdog
        self.is_open, self._opened_s = True, now_s
        self._next_heartbeat_s = now_s
        self.poll(now_s)

    def closed(self, now_s):
        """Note that the device was lost."""
        self.is_open = self.is_connected = False
        self._end_orders(self._why_deaf())

    def missing_streams(self):
        """Return the names of the missing telemetry streams."""
        return self._streams.missing() if self.is_connected else []

    def send_last_words(self):
        """Release the channels and continue an emergency stop. To be called LAST_WORDS times at the end."""
        if self._stop_until_s > -math.inf:
            self._send("command_long", **orders.KILL)
        if self.is_overriding or self._releases:
            self._send("rc_channels_override", **dict.fromkeys(_CHANNELS, RELEASED))

    def _encode(self, name, **fields):
        if name != "heartbeat":
            system, component = self.target or _EVERYONE
            fields["target_system"] = system
            if name != "set_mode":
                fields["target_component"] = component
        return self._encoder.encode(self.version, name, **fields)

    def _send(self, name, **fields):
        self._write(self._encode(name, **fields))

    # --- from the vehicle -----------------------------------------------------------------------------------------
    def receive(self, data, now_s):
        """Handle bytes from the device; return the list of the vehicle's messages to publish."""
        return [message for message in self.reader.feed(data, now_s) if self._takes(message, now_s)]

    def _takes(self, message, now_s):
        """Handle a message; return whether it is from the vehicle and does not repeat another message."""
        kind = message.get_type()
        if (message.get_srcSystem(), message.get_srcComponent()) != self.target:
            if kind != "HEARTBEAT" or not self._meets(message):
                return False
        self._heard_s = now_s
        self.version = version_of(message)
        if not self.is_connected:
            self._connect(now_s)
        self._count(message.get_seq())
        self._look_for_reboot(getattr(message, "time_boot_ms", None), now_s)
        self._streams.note(kind)
        handle = self._HANDLERS.get(kind)
        is_new = handle is None or handle(self, message, now_s) is not False
        if getattr(message, "target_system", 0) in (0, self._options.source_system):  # not for another ground station
            for order, _ in self._running():
                order.on_message(message, now_s)
            self._end_finished()
        return is_new

    def _meets(self, heartbeat):
        """Whether a heartbeat is the first one of a vehicle, which then becomes our target."""
        system = heartbeat.get_srcSystem()
        is_vehicle = (
            heartbeat.get_srcComponent() == _VEHICLE_COMPONENT
            and heartbeat.autopilot != mavlink.MAV_AUTOPILOT_INVALID
            and heartbeat.type != mavlink.MAV_TYPE_GCS
        )
        if is_vehicle and self.target is None:
            self.target = system, _VEHICLE_COMPONENT
            if (heartbeat.type in _ROVERS) != (self._options.type == "ArduRover"):
                text = "--type is %s, but the heartbeat is of type %d of MAV_TYPE: the names of modes may be wrong"
                self._report("warn", text % (self._options.type, heartbeat.type))
            return True
        if is_vehicle and system not in (self.target[0], *self._strangers):
            text = "system %d is on the same link and is ignored: this is the driver of system %d"
            self._report("warn", text % (system, self.target[0]))
        self._strangers.add(system)
        return False

    def _connect(self, now_s):
        self.is_connected = True
        if self.heartbeat_s is None:
            text = "system %d found, MAVLink %d" % (self.target[0], self.version)
        else:
            self.counts["reconnects"] += 1
            text = "the autopilot is back"
        self._report("info", text)
        self._sequence = None
        self._streams.restart(now_s)

    def _count(self, sequence):
        self.counts["messages"] += 1
        lost = 0 if self._sequence is None else (sequence - self._sequence - 1) % 256
        if lost < 128:  # else the message was late or a duplicate
            self.counts["lost messages"] += lost
        self._sequence = sequence

    def _look_for_reboot(self, boot_ms, now_s):
        if boot_ms is None:
            return
        if self._boot_ms is not None and boot_ms < self._boot_ms - REBOOT_MS:
            self.counts["reboots"] += 1
            self._report("warn", "the autopilot has rebooted")
            self._end_orders("the autopilot has rebooted")
            self._streams.restart(now_s)
        self._boot_ms = boot_ms

    def _on_heartbeat(self, heartbeat, now_s):
        self._tell_all(self._texts.flush())
        self.heartbeat_s = now_s
        self._heartbeats += 1
        self.is_armed = orders.is_armed(heartbeat)
        self.mode = mode_name(self._options.type, heartbeat)

    def _on_text(self, message, now_s):
        self._tell_all(self._texts.add(message))

    def _tell_all(self, texts):
        for severity, text in texts:
            level = next(level for most, level in _LEVELS if severity <= most)
            self._report(level, "autopilot: " + text)
            for order, _ in self._running():
                order.on_text(severity, text)

    def _on_position(self, message, now_s):
        self._home = message.lat, message.lon

    def _on_channels(self, message, now_s):
        self._has_channels = now_s
        self._look_at_switch(message, now_s)

    def _on_raw_channels(self, message, now_s):
        if now_s - self._has_channels < LOST_S or message.port:
            return False  # repeats RC_CHANNELS, or has channels 9 to 16
        return self._look_at_switch(message, now_s)

    def _look_at_switch(self, message, now_s):
        value_us = getattr(message, _CHANNELS[self._options.autonomous_channel_id - 1])
        self._switch_s = now_s
        self._switch(value_us != UNCHANGED and value_us >= SWITCH_ON_US, now_s)

    def _switch(self, is_on, now_s):
        if self._options.enable_autonomous_control and is_on != self._is_switched_on:
            self._report("info", "the pilot's switch is %s" % ("on: send_rc counts" if is_on else "off"))
            if not is_on:
                self.release(now_s)
        self._is_switched_on = is_on

    _HANDLERS = {
        "HEARTBEAT": _on_heartbeat,
        "STATUSTEXT": _on_text,
        "GLOBAL_POSITION_INT": _on_position,
        "RC_CHANNELS": _on_channels,
        "RC_CHANNELS_RAW": _on_raw_channels,
    }

    # --- orders -------------------------------------------------------------------------------------------------------
    def begin(self, order, on_end, now_s):
        """Carry out an Order; on_end is called with its Outcome. A newer order replaces a running one."""
        self._replace("_order", order, on_end, now_s)

    def send_mission(self, items, on_end, now_s):
        """Make `orders.Item`s the mission; an empty list clears it."""
        step_s = self._options.waypoint_timeout / 1000.0
        home = orders.Item(
            mavlink.MAV_CMD_NAV_WAYPOINT,
            latitude=self._home[0],
            longitude=self._home[1],
            frame=mavlink.MAV_FRAME_GLOBAL,
        )
        order = orders.SendMission([home, *items], step_s) if items else orders.ClearMission(step_s)
        self._replace("_mission", order, on_end, now_s)

    def _replace(self, place, order, on_end, now_s):
        self._end(place, orders.Outcome(False, "%s was ordered meanwhile" % order.what))
        if self._why_deaf():  # not if the autopilot has only fallen silent: it may still receive
            on_end(self._told(order, orders.Outcome(False, self._why_deaf())))
        elif now_s < self._stop_until_s and place == "_order":
            on_end(self._told(order, orders.Outcome(False, "the motors are being stopped")))
        else:
            setattr(self, place, (order, on_end))
            order.begin(self._send, now_s)
            self._end_finished()

    def _why_deaf(self):
        """Return why no order can reach the autopilot; "" if none is known."""
        if not self.is_open:
            return "%s is not there" % self._options.device
        return "" if self.target else "no autopilot has been heard yet"

    def _told(self, order, outcome):
        if outcome.is_done:
            self._report("info", "%s: done" % order.what)
        else:
            self._report("error", "%s failed: %s" % (order.what, outcome.why))
        return outcome

    def _running(self):
        return [running for running in (self._order, self._mission) if running is not None]

    def _end(self, place, outcome):
        running = getattr(self, place)
        if running is not None:
            setattr(self, place, None)
            order, on_end = running
            on_end(self._told(order, outcome))

    def _end_orders(self, why):
        for place in ("_order", "_mission"):
            self._end(place, orders.Outcome(False, why))

    def _end_finished(self):
        for place in ("_order", "_mission"):
            running = getattr(self, place)
            if running is not None and running[0].outcome is not None:
                self._end(place, running[0].outcome)

    # --- the channels of the remote control -----------------------------------------------------------------------
    def override(self, channels, posted_s, now_s):
        """Send RC_CHANNELS_OVERRIDE. channels: eight of [us], RELEASED or UNCHANGED. posted_s: when they arrived."""
        if now_s - posted_s > self._options.rc_timeout / 1000.0:
            why = "they have waited too long for the device"
        else:
            why = self._why_not_override(channels, now_s)
        if why:
            self.counts["refused send_rc"] += 1
            if why != self._ignoring or now_s - self._ignoring_s > REPEAT_S:
                self._report("warn", "send_rc is ignored: %s" % why)
                self._ignoring, self._ignoring_s = why, now_s
            return
        channels = list(channels)
        if self._options.enable_autonomous_control:  # the pilot's switch must not be overridden
            channels[self._options.autonomous_channel_id - 1] = UNCHANGED
        self._send("rc_channels_override", **dict(zip(_CHANNELS, channels)))
        self.is_overriding, self._override_s, self._releases = True, now_s, 0

    def _why_not_override(self, channels, now_s):
        options = self._options
        if not options.enable_rc_control:
            return "--enable-rc-control true is not among the driver's options"
        if len(channels) != len(_CHANNELS) or any(
            not (_LEAST_US <= value <= _MOST_US or value in (RELEASED, UNCHANGED)) for value in channels
        ):
            return "it must be eight times %d .. %d us, 0 or 65535" % (_LEAST_US, _MOST_US)
        if self._why_deaf():
            return self._why_deaf()
        if now_s < self._stop_until_s:
            return "the motors are being stopped"
        if options.enable_autonomous_control and not self._is_switched_on:
            return "the pilot's switch, channel %d, is not on" % options.autonomous_channel_id
        if options.enable_watchdog and self._has_run_out:
            return "the watchdog has run out"
        return ""

    def release(self, now_s):
        """Return all channels to the pilot's radio. Sends nothing if overriding is not enabled."""
        if not self._options.enable_rc_control:
            return
        self.is_overriding = False
        self._releases, self._next_release_s = RELEASES, now_s
        self._go_on_releasing(now_s)

    def _go_on_releasing(self, now_s):
        if self._releases and self.is_open and now_s >= self._next_release_s:
            self._releases -= 1
            self._next_release_s = now_s + RELEASE_S
            self._send("rc_channels_override", **dict.fromkeys(_CHANNELS, RELEASED))

    # --- watchdog and emergency stop ----------------------------------------------------------------------------------
    def feed_watchdog(self, is_well, now_s):
        """Handle a message on the topic `watchdog`; is_well false: the watchdog runs out at once."""
        self._fed_s = now_s if is_well else -math.inf
        if is_well and self._has_run_out:
            self._has_run_out = self._owes_failsafe = False
            self._report("info", "the watchdog is fed again")
        elif not is_well:
            self._watch(now_s)

    def _watch(self, now_s):
        options = self._options
        if now_s - self._fed_s > options.max_watchdog_time and not self._has_run_out:
            self._has_run_out, self._owes_failsafe = True, options.enable_ros_failsafe
            self._report("error", "the watchdog has run out: no true on its topic for %g s" % options.max_watchdog_time)
            if self.is_overriding:
                self.release(now_s)
        is_landing = self._order is not None and self._order[1] == self._on_failsafe
        if self._owes_failsafe and self.is_armed and not is_landing and not self._why_deaf():
            name = _FAILSAFE_MODE[options.type]
            order = orders.SetMode(name, mode_number(options.type, name), options.mode_timeout / 1000.0)
            self.begin(order, self._on_failsafe, now_s)

    def _on_failsafe(self, outcome):
        self._owes_failsafe = self._owes_failsafe and not outcome.is_done

    def emergency_stop(self, now_s):
        """Stop the motors at once, wherever the vehicle is; all running orders end."""
        doubt = self._why_deaf()
        self._report("error", "EMERGENCY STOP: the motors are ordered to stop" + (doubt and ", but %s" % doubt))
        self._stop_until_s, self._next_stop_s, self._stops = now_s + STOP_S, now_s, 0
        self._heartbeats_before_stop = self._heartbeats
        self._go_on_stopping(now_s)
        self._end_orders("emergency stop")
        if self.is_overriding:
            self.release(now_s)

    def _go_on_stopping(self, now_s):
        if self._stop_until_s == -math.inf:
            return
        has_stopped = self._heartbeats > self._heartbeats_before_stop and not self.is_armed
        if has_stopped and self._stops >= STOPS:
            self._stop_until_s = -math.inf
            self._report("warn", "the motors have stopped: the vehicle is disarmed")
        elif now_s >= self._stop_until_s:
            self._stop_until_s = -math.inf
            self._report("error", "the emergency stop was sent; the autopilot does not tell that it is disarmed")
        elif now_s >= self._next_stop_s:
            self._next_stop_s += STOP_PERIOD_S
            self._stops += 1
            self._send("command_long", **orders.KILL)

    # --- time ---------------------------------------------------------------------------------------------------------
    def poll(self, now_s):
        """Do what is due."""
        self._go_on_stopping(now_s)
        if self.is_open and now_s >= self._next_heartbeat_s:
            self._next_heartbeat_s = max(self._next_heartbeat_s + HEARTBEAT_S, now_s + HEARTBEAT_S / 2)
            self._send(
                "heartbeat",
                type=mavlink.MAV_TYPE_GCS,
                autopilot=mavlink.MAV_AUTOPILOT_INVALID,
                base_mode=0,
                custom_mode=0,
                system_status=mavlink.MAV_STATE_ACTIVE,
                mavlink_version=3,
            )
        self._judge_silence(now_s)
        for order, _ in self._running():
            order.poll(now_s)
        self._end_finished()
        if self.is_connected:
            for stream, rate_hz in self._streams.wanted(now_s):
                self._send("request_data_stream", req_stream_id=stream, req_message_rate=rate_hz, start_stop=1)
        if self.is_overriding and now_s - self._override_s > self._options.rc_timeout / 1000.0:
            self._report("warn", "send_rc is silent: the channels are given back to the pilot's radio")
            self.release(now_s)
        self._go_on_releasing(now_s)
        if now_s - self._switch_s > SWITCH_STALE_S:
            self._switch(False, now_s)
        if self._options.enable_watchdog and now_s >= self._next_watch_s:
            self._next_watch_s = now_s + 1.0 / self._options.watchdog_rate
            self._watch(now_s)

    def _judge_silence(self, now_s):
        if self.is_connected and now_s - self._heard_s > LOST_S:
            self.is_connected = False
            self._tell_all(self._texts.flush())
            text = "no word from the autopilot for %g s; waiting for it. Is it on, and in reach of the radio?"
            self._report("error", text % LOST_S)
        elif self.target is None and not self._has_complained and now_s - self._opened_s > PATIENCE_S:
            self._has_complained = True
            text = "no autopilot is heard on %s: %s; waiting for it"
            self._report("warn", text % (self._options.device, self._what_is_heard()))

    def _what_is_heard(self):
        if self._strangers:
            return "only system(s) %s, no vehicle" % ", ".join(map(str, sorted(self._strangers)))
        if self.reader.frames:
            return "MAVLink, but no heartbeat of a vehicle"
        if self.reader.skipped_bytes:
            return "bytes that are not MAVLink, is the baud rate right?"
        return "nothing, is it on and connected?"
