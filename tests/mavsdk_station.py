"""A MAVSDK ground station that flies a vehicle by its sticks: mavsdk_station.py URL. Prints what it saw as JSON."""

import json
import sys
import threading
import time

import mavsdk
from mavsdk.plugins.action import Action
from mavsdk.plugins.info import Info
from mavsdk.plugins.manual_control import ManualControl
from mavsdk.plugins.mission_raw import MissionRaw
from mavsdk.plugins.param import Param
from mavsdk.plugins.telemetry import Telemetry

PATIENCE_S = 60.0
ON_GROUND = 1  # Telemetry.LandedState
RATES = "position battery attitude_euler rc_status landed_state in_air gps_info health position_velocity_ned raw_imu"


class Station:
    """Keeps the newest value of each kind of telemetry, and everything that MAVSDK has logged."""

    def __init__(self, url):
        self.logs, self.newest, self.texts, self.most_m = [], {}, [], 0.0
        self.sticks = 0.0, 0.0, 0.0, 0.0  # forward, right, up from 0 to 1, clockwise
        mavsdk.log_subscribe(self._log)
        self._configuration = mavsdk.Configuration.create_with_component_type(mavsdk.ComponentType.GROUND_STATION)
        self._sdk = mavsdk.Mavsdk(self._configuration)
        start_s = time.monotonic()
        result = self._sdk.add_any_connection(url)
        assert result == mavsdk.ConnectionResult.SUCCESS, result
        self.system = self._sdk.first_autopilot(PATIENCE_S)
        assert self.system is not None, "no autopilot"
        self.connected_s = time.monotonic() - start_s

    @property
    def system_id(self):
        return self._configuration.system_id

    def _log(self, level, message, _file, _line):
        self.logs.append((level.name, message))
        return True

    def complaints(self):
        return [log for log in self.logs if log[0] in ("WARN", "ERROR")]

    def be_told_nonsense(self):
        """Cause a complaint, for the control arm."""
        self._sdk.add_any_connection("nonsense://")

    def watch(self, telemetry, *names):
        for name in names:
            getattr(telemetry, "subscribe_" + name)(lambda value, *_, name=name: self._see(name, value))

    def _see(self, name, value):
        self.newest[name] = value
        if name == "status_text":
            self.texts.append(value.text)
        if name == "position":
            self.most_m = max(self.most_m, value.relative_altitude_m)

    def wait(self, what, is_so):
        end_s = time.monotonic() + PATIENCE_S
        while not is_so():
            assert time.monotonic() < end_s, "%s: %r, %r" % (what, self.newest, self.logs)
            time.sleep(0.01)

    def steer(self, manual_control):
        """Send the sticks from now on, as a joystick does."""

        def go_on():
            while True:
                manual_control.set_manual_control_input(*self.sticks)
                time.sleep(0.04)

        threading.Thread(target=go_on, daemon=True).start()


def main(url):
    station = Station(url)
    system, newest = station.system, station.newest
    version = Info(system).get_version()
    telemetry, parameters, missions = Telemetry(system), Param(system), MissionRaw(system)
    watched = "armed in_air landed_state position battery rc_status status_text gps_info health home attitude_euler"
    station.watch(telemetry, *watched.split())
    for name in RATES.split():
        getattr(telemetry, "set_rate_" + name)(10.0)
    station.wait("telemetry", lambda: {"position", "battery", "landed_state", "gps_info", "armed"} <= set(newest))
    before = parameters.get_param_int("SYSID_MYGCS")
    parameters.set_param_int("SYSID_MYGCS", station.system_id)
    everything = parameters.get_all_params()
    lists = [missions.download_mission(), missions.download_geofence(), missions.download_rallypoints()]

    sticks, action = ManualControl(system), Action(system)
    station.steer(sticks)
    station.wait("sticks", lambda: newest["rc_status"].is_available)
    sticks.start_altitude_control()
    action.arm()
    station.wait("armed", lambda: newest["armed"])
    station.sticks = 0.0, 0.0, 0.8, 0.0
    station.wait("take-off", lambda: newest["in_air"] and newest["position"].relative_altitude_m > 0.6)
    station.sticks = 0.0, 0.0, 0.5, 0.0
    action.land()
    station.wait("landing", lambda: newest["landed_state"] == ON_GROUND and not newest["armed"])
    result = {
        "connected_s": station.connected_s,
        "complaints": station.complaints(),
        "texts": station.texts,
        "most_m": station.most_m,
        "end_m": newest["position"].relative_altitude_m,
        "version": [version.flight_sw_major, version.flight_sw_minor],
        "sysid_mygcs": before,
        "parameters": len(everything.int_params) + len(everything.float_params),
        "mission_items": [len(items) for items in lists],
        "fix": int(newest["gps_info"].fix_type),
        "battery_pct": newest["battery"].remaining_percent,
    }
    station.be_told_nonsense()
    station.wait("a complaint", lambda: len(station.complaints()) > len(result["complaints"]))
    print(json.dumps(result), flush=True)


if __name__ == "__main__":
    main(sys.argv[1])
