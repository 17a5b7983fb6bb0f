"""The autopilot of a virtual IRIS+: modes, arming and its refusals, gestures, failsafes, overrides, landing."""

import functools

import pytest
from iris_flight import CENTRE_US, HIGHEST_US, LOWEST_US, Hands, make_world

from risc_simulator.models.flight import FlightAction, FlightPhase, Setpoint
from risc_simulator.vehicles.iris import firmware
from risc_simulator.vehicles.iris.firmware import CRITICAL_BATTERY_PCT, LOW_BATTERY_PCT, Mode, RcFrame
from risc_simulator.vehicles.iris.sensors import CAPACITY_AH, GROUND_PRESSURE_PA

LAND_M_S = 0.4


@pytest.fixture
def hands():
    return Hands(make_world(step_s=0.005))


@pytest.fixture
def flyer():
    hands = Hands(make_world())
    hands.take_off(1.0)
    hands.texts()
    return hands


def goes_up(hands):
    """Whether it leaves the floor with the throttle raised."""
    hands.send(1.0, throttle=hands.throttle_for(1.0))
    return hands.vehicle.height_m > 0.2


# ------------------------------------------------------------------ arming


def test_it_stands_disarmed_and_deaf_to_the_throttle(hands):
    hands.send(1.0, throttle=HIGHEST_US)
    assert (hands.autopilot.armed, hands.vehicle.phase) == (False, FlightPhase.LANDED)
    assert hands.vehicle.state.motor_pwm == (0, 0, 0, 0) and hands.vehicle.height_m == 0.08


def test_armed_on_the_ground_its_rotors_idle_and_it_stands(hands):
    hands.arm()
    hands.send(2.0, roll=HIGHEST_US, throttle=hands.throttle_for(-0.2))
    state = hands.vehicle.state
    assert hands.autopilot.armed and state.motor_pwm == (40, 40, 40, 40)
    assert (state.phi, hands.vehicle.height_m, hands.vehicle.phase) == (0.0, 0.08, FlightPhase.LANDED)
    assert state.specific_force_m_s2[2] == pytest.approx(-9.80665)
    assert goes_up(hands) and hands.vehicle.phase is FlightPhase.FLYING


def low_battery(hands):
    hands.vehicle.set_battery_pct(LOW_BATTERY_PCT - 0.1)


def land_mode(hands):
    assert hands.autopilot.set_mode(Mode.LAND) == ""


TROUBLES = {
    "PreArm: Radio failsafe on": lambda hands: hands.wait(0.6),
    "Arm: Throttle too high": lambda hands: hands.send(0.1, throttle=1031),
    "PreArm: Battery below minimum arming capacity": low_battery,
    "Arm: Land mode not armable": land_mode,
}


@pytest.mark.parametrize("text", TROUBLES)
def test_why_it_does_not_arm(hands, text):
    hands.send(0.5)
    assert hands.autopilot.arming_trouble() == ""
    hands.texts()
    TROUBLES[text](hands)
    assert hands.autopilot.arming_trouble() == text
    assert hands.autopilot.arm() == text and not hands.autopilot.armed
    assert hands.texts()[-1] == text
    if text != "Arm: Land mode not armable":
        hands.autopilot.parameters.set("ARMING_CHECK", 0)
        assert hands.autopilot.arm() == ""


def test_by_force_it_arms_whatever_the_checks_say(hands):
    hands.send(0.1, throttle=1600)
    assert hands.autopilot.arm(by_force=True) == "" and hands.autopilot.armed


def test_before_the_first_frame_there_is_no_radio(hands):
    hands.wait(0.1)
    assert hands.autopilot.channels_us == () and hands.autopilot.radio_failsafe
    assert hands.autopilot.arm() == "PreArm: Radio failsafe on"


# ------------------------------------------------------------------ gestures


def test_throttle_low_and_yaw_right_for_two_seconds_arms(hands):
    hands.send(0.5)
    hands.send(1.9, yaw=HIGHEST_US)
    assert not hands.autopilot.armed
    hands.send(0.14, yaw=HIGHEST_US)
    assert hands.autopilot.armed and hands.texts()[-1] == "Arming motors"


@pytest.mark.parametrize("interruption", [{"yaw": 1900}, {"yaw": HIGHEST_US, "throttle": 1031}])
def test_a_gesture_that_is_interrupted_begins_anew(hands, interruption):
    hands.send(1.5, yaw=HIGHEST_US)
    hands.send(0.06, **interruption)
    hands.send(1.9, yaw=HIGHEST_US)
    assert not hands.autopilot.armed
    hands.send(0.2, yaw=HIGHEST_US)
    assert hands.autopilot.armed


def test_a_gesture_that_is_refused_says_so_once(hands):
    hands.vehicle.set_battery_pct(10.0)
    hands.send(6.0, yaw=HIGHEST_US)
    assert hands.texts().count("PreArm: Battery below minimum arming capacity") == 1


def test_yaw_left_disarms_on_the_ground_and_not_in_the_air(hands):
    hands.arm()
    hands.send(1.9, yaw=LOWEST_US)
    assert hands.autopilot.armed
    hands.send(0.2, yaw=LOWEST_US)
    assert not hands.autopilot.armed
    hands.take_off(1.4)
    hands.autopilot.set_mode(Mode.ALT_HOLD)  # descends at full speed, with the disarming gesture
    hands.send(0.7, yaw=LOWEST_US)
    assert hands.autopilot.armed and hands.vehicle.phase is FlightPhase.FLYING


def test_rudder_arming_can_be_switched_off(hands):
    hands.autopilot.parameters.set("ARMING_RUDDER", 0)
    hands.send(3.0, yaw=HIGHEST_US)
    assert not hands.autopilot.armed


# ------------------------------------------------------------------ disarming


def test_a_flying_vehicle_is_disarmed_only_by_force_and_then_falls(flyer):
    assert flyer.autopilot.disarm() == "Disarm: not landed"
    flyer.fly_to(1.0, 0.5)
    assert flyer.autopilot.armed
    assert flyer.autopilot.disarm(by_force=True) == ""
    flyer.send(0.2, throttle=1600)
    assert flyer.vehicle.phase is FlightPhase.EMERGENCY and flyer.vehicle.state.motor_pwm == (0, 0, 0, 0)
    assert flyer.vehicle.state.velocity_m_s[2] == pytest.approx(-9.8 * 0.2, rel=0.1)
    flyer.send(1.0)
    assert flyer.vehicle.phase is FlightPhase.LANDED and not flyer.world.crashes
    assert flyer.autopilot.arm() == ""


def test_idle_on_the_ground_it_disarms_after_ten_seconds(hands):
    hands.arm()
    hands.send(5.0)
    hands.send(0.1, throttle=1040)
    hands.send(9.8)
    assert hands.autopilot.armed
    hands.send(0.3)
    assert not hands.autopilot.armed


def test_cut_motors_is_a_disarming_by_force(flyer):
    flyer.vehicle.schedule(flyer.world.time_s, FlightAction.CUT_MOTORS)
    flyer.send(0.1)
    assert not flyer.autopilot.armed


# ------------------------------------------------------------------ modes


def test_alt_hold_keeps_its_height_with_the_throttle_in_the_middle(flyer):
    flyer.autopilot.set_mode(Mode.ALT_HOLD)
    flyer.send(4.0, throttle=1500, pitch=1523)
    assert flyer.vehicle.height_m == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize("perturbed", [False, True])
@pytest.mark.parametrize("throttle_us, share", [(2000, 1.0), (1800, 0.5), (1600, 0.0), (1400, 0.0), (1000, -1.0)])
def test_alt_hold_climbs_by_the_throttle_beyond_its_dead_zone(throttle_us, share, perturbed):
    hands = Hands(make_world(perturbed=perturbed, seed=7))
    hands.vehicle.fly_at((0.0, 0.0, 1.5 - 0.7 * share))
    hands.autopilot.set_mode(Mode.ALT_HOLD)
    hands.send(1.2, throttle=throttle_us)
    wanted_m_s = share * hands.vehicle.type.climb_max_m_s
    assert hands.vehicle.state.velocity_m_s[2] == pytest.approx(wanted_m_s, abs=0.12)


@pytest.mark.parametrize("mode, descent_m_s", [(Mode.ALT_HOLD, 0.0), (Mode.LAND, LAND_M_S)])
def test_what_the_throttle_hovered_with_is_known_when_the_climb_loop_takes_over(mode, descent_m_s):
    """Otherwise a perturbed vehicle would sink or rise for seconds."""
    worst_m_s = 0.0
    for seed in range(6):
        hands = Hands(make_world(perturbed=True, seed=seed))
        hands.vehicle.fly_at((0.0, 0.0, 1.5))
        hands.fly_to(1.5, 6.0)
        hands.send(0.06, throttle=LOWEST_US)  # as a transmitter's failsafe does, before the autopilot reacts to it
        hands.autopilot.set_mode(mode)
        hands.send(1.2, throttle=CENTRE_US)
        worst_m_s = max(worst_m_s, abs(hands.vehicle.state.velocity_m_s[2] + descent_m_s))
    assert worst_m_s < 0.08


def test_alt_hold_takes_off_and_lands_by_the_throttle(hands):
    hands.autopilot.set_mode(Mode.ALT_HOLD)
    hands.arm()
    hands.send(1.0, throttle=1500)
    assert hands.vehicle.height_m == 0.08
    hands.send(1.5, throttle=1900)
    assert hands.vehicle.height_m > 0.5
    hands.send(4.0, until=lambda: hands.vehicle.phase is FlightPhase.LANDED)
    assert not hands.world.crashes and hands.autopilot.armed
    hands.send(10.5)
    assert not hands.autopilot.armed


def test_land_descends_stands_and_disarms(flyer):
    flyer.autopilot.set_mode(Mode.LAND)
    flyer.send(1.2, throttle=1500)
    assert flyer.vehicle.phase is FlightPhase.LANDING
    assert flyer.vehicle.state.velocity_m_s[2] == pytest.approx(-LAND_M_S, abs=0.03)
    assert flyer.send(3.0, throttle=1500, until=lambda: flyer.vehicle.phase is FlightPhase.LANDED)
    stood_s = flyer.world.time_s
    assert flyer.send(3.0, throttle=1500, until=lambda: not flyer.autopilot.armed)
    assert flyer.world.time_s - stood_s == pytest.approx(firmware.LANDED_DISARM_S, abs=0.05)
    assert flyer.texts() == ["Disarming motors"] and not flyer.world.crashes
    assert flyer.autopilot.arm() == "Arm: Land mode not armable"
    flyer.autopilot.set_mode(Mode.STABILIZE)
    flyer.send(0.1)
    assert flyer.autopilot.arm() == ""


def test_in_land_the_sticks_still_tilt_it_and_the_throttle_does_nothing(flyer):
    flyer.autopilot.set_mode(Mode.LAND)
    flyer.send(0.8, roll=1550, throttle=2000)
    assert flyer.vehicle.state.phi > 0.03 and flyer.vehicle.state.velocity_m_s[2] < -0.3


@pytest.mark.parametrize("number", [3, 4, 5, 6, 16, 1, 99, -1])
def test_a_mode_that_it_has_not_is_refused(flyer, number):
    assert "requires position" in flyer.autopilot.set_mode(number)
    flyer.fly_to(1.0, 0.5)
    assert flyer.autopilot.mode is Mode.STABILIZE and len(flyer.texts()) == 1


def test_from_land_back_to_stabilize_the_throttle_has_it_again(flyer):
    flyer.autopilot.set_mode(Mode.LAND)
    flyer.send(0.5, throttle=1500)
    flyer.autopilot.set_mode(Mode.STABILIZE)
    flyer.fly_to(1.0, 3.0)
    assert flyer.vehicle.height_m == pytest.approx(1.0, abs=0.05)


def test_what_is_no_action_is_an_error_in_the_program(flyer):
    with pytest.raises(TypeError, match="RcFrame"):
        flyer.autopilot.apply(Setpoint(), 0.0, None)


# ------------------------------------------------------------------ sticks


@pytest.mark.parametrize("us, angle", [(1520, 0.0), (1480, 0.0), (2000, 0.785398), (1000, -0.785398), (1760, 0.392699)])
@pytest.mark.parametrize("channel", [0, 1])
def test_dead_zone_and_full_scale_of_a_stick(hands, channel, us, angle):
    frame = [1500, 1500, 1000, 1500]
    frame[channel] = us
    hands.vehicle.schedule(0.0, RcFrame(tuple(frame)))
    hands.wait(0.01)
    assert hands.autopilot.command[channel] == pytest.approx(angle, abs=1e-4)


def test_parameters_change_what_a_stick_means(hands):
    hands.autopilot.parameters.set("ANGLE_MAX", 3000)
    hands.autopilot.parameters.set("RC1_REVERSED", 1)
    hands.autopilot.parameters.set("RC1_MAX", 1900)
    hands.send(0.1, roll=1900)
    assert hands.autopilot.command[0] == pytest.approx(-0.5236, abs=1e-3)


def test_its_parameters_say_what_its_sensors_read(hands):
    parameters = hands.autopilot.parameters
    assert (parameters["BATT_CAPACITY"], parameters["BARO1_GND_PRESS"]) == (1e3 * CAPACITY_AH, GROUND_PRESSURE_PA)


@pytest.mark.parametrize("changes", [{"tilt_max_rad": 0.1}, {"climb_max_m_s": 0.2}, {"yaw_rate_max_rad_s": 7.0}])
def test_full_scales_that_arducopter_has_not_are_refused_by_name(changes):
    with pytest.raises(ValueError, match="'iris': tilt_max_rad, .*ArduCopter"):
        make_world(changes=changes)


# ------------------------------------------------------------------ failsafes


def test_without_frames_it_lands_after_half_a_second(flyer):
    flyer.wait(0.45)
    assert flyer.autopilot.mode is Mode.STABILIZE
    flyer.wait(0.1)
    assert (flyer.autopilot.mode, flyer.autopilot.radio_failsafe) == (Mode.LAND, True)
    flyer.wait(5.0)
    assert flyer.vehicle.phase is FlightPhase.LANDED and not flyer.autopilot.armed and not flyer.world.crashes
    assert flyer.texts() == ["Radio Failsafe", "Disarming motors"]


def test_without_the_radio_failsafe_it_would_fly_on_its_last_sticks(flyer):
    """The control arm of the test above."""
    flyer.autopilot.parameters.set("FS_THR_ENABLE", 0)
    flyer.send(0.1, roll=1560, throttle=flyer.throttle_for())
    flyer.wait(0.6)
    assert flyer.autopilot.mode is Mode.STABILIZE and flyer.vehicle.phase is FlightPhase.FLYING
    assert flyer.vehicle.state.phi > 0.05


def test_a_lost_radio_levels_it(flyer):
    flyer.send(0.3, roll=1700, throttle=flyer.throttle_for())
    tilted = flyer.vehicle.state.phi
    flyer.wait(1.2)
    assert tilted > 0.1 > 0.01 > abs(flyer.vehicle.state.phi)


@pytest.mark.parametrize("frames, lands", [(2, False), (3, True)])
def test_a_throttle_below_975_us_counts_as_a_lost_radio_from_the_third_frame_on(flyer, frames, lands):
    for _ in range(frames):
        flyer.send(0.02, throttle=974)
    flyer.fly_to(1.0, 0.3)
    assert (flyer.autopilot.mode is Mode.LAND) is lands


def test_a_throttle_of_975_us_is_a_throttle(flyer):
    flyer.send(0.1, throttle=975)
    assert flyer.autopilot.mode is Mode.STABILIZE


def test_when_the_radio_comes_back_it_goes_on_landing_until_the_mode_is_changed(flyer):
    flyer.wait(0.6)
    flyer.send(0.3, throttle=1500)
    assert flyer.texts() == ["Radio Failsafe", "Radio Failsafe Cleared"]
    assert flyer.autopilot.mode is Mode.LAND
    flyer.autopilot.set_mode(Mode.STABILIZE)
    flyer.fly_to(1.0)
    assert flyer.vehicle.height_m == pytest.approx(1.0, abs=0.05)


def test_a_lost_radio_disarms_on_the_ground(hands):
    hands.arm()
    hands.wait(0.6)
    assert not hands.autopilot.armed


def test_a_critical_battery_lands_and_a_low_one_says_so(flyer):
    flyer.vehicle.set_battery_pct(LOW_BATTERY_PCT)
    flyer.fly_to(1.0, 1.1)
    assert flyer.texts() == ["Battery failsafe: low"] and flyer.autopilot.mode is Mode.STABILIZE
    flyer.vehicle.set_battery_pct(CRITICAL_BATTERY_PCT)
    flyer.fly_to(1.0, 1.1)
    assert flyer.texts() == ["Battery failsafe: critical"] and flyer.autopilot.mode is Mode.LAND
    flyer.send(6.0, throttle=1500)
    assert flyer.vehicle.phase is FlightPhase.LANDED and not flyer.autopilot.armed


def test_the_battery_drains_a_tenth_as_fast_on_the_ground(hands):
    hands.wait(9.0)
    life_s = hands.vehicle.type.battery_life_s
    assert hands.vehicle.battery_pct == pytest.approx(100.0 - 100.0 * 0.1 * 9.0 / life_s, abs=1e-6)
    hands.vehicle.set_battery_pct(50.0)
    hands.arm()
    armed = hands.vehicle.battery_pct
    hands.send(9.0)
    assert armed - hands.vehicle.battery_pct == pytest.approx(100.0 * 9.0 / life_s, abs=1e-6)


# ------------------------------------------------------------------ overrides


RELEASE, LEAVE = 0, 65535


def test_an_override_replaces_a_channel_until_it_is_released(hands):
    hands.send(0.1)
    hands.autopilot.override((1600, LEAVE, LEAVE, LEAVE), hands.world.time_s)
    hands.send(0.1)
    assert hands.autopilot.channels_us[:4] == (1600, 1500, 1000, 1500)
    hands.autopilot.override((LEAVE, 1700, LEAVE, LEAVE), hands.world.time_s)
    hands.send(0.1)
    assert hands.autopilot.channels_us[:4] == (1600, 1700, 1000, 1500)
    hands.autopilot.override((RELEASE, LEAVE, LEAVE, LEAVE), hands.world.time_s)
    hands.send(0.1)
    assert hands.autopilot.channels_us[:4] == (1500, 1700, 1000, 1500)


def test_an_override_lasts_three_seconds(hands):
    hands.send(0.1)
    hands.autopilot.override((1600,), hands.world.time_s)
    hands.send(2.9)
    assert hands.autopilot.channels_us[0] == 1600
    hands.send(0.2)
    assert hands.autopilot.channels_us[0] == 1500


def test_overrides_alone_arm_and_keep_the_radio_failsafe_away(hands):
    def override(throttle_us):
        hands.autopilot.override((1500, 1500, throttle_us, 1500), hands.world.time_s)
        hands.wait(0.1)

    override(1000)
    assert hands.autopilot.arm() == ""
    for _ in range(20):
        override(hands.throttle_for(0.5))
    assert hands.vehicle.phase is FlightPhase.FLYING
    hands.wait(0.85)
    assert hands.autopilot.mode is Mode.STABILIZE
    hands.wait(0.2)
    assert hands.autopilot.mode is Mode.LAND


def test_with_an_override_in_force_a_silent_radio_counts_as_lost_after_a_second(flyer):
    flyer.autopilot.override((1500, 1500, flyer.throttle_for(), 1500), flyer.world.time_s)
    flyer.wait(0.9)
    assert flyer.autopilot.mode is Mode.STABILIZE
    flyer.wait(0.2)
    assert flyer.autopilot.mode is Mode.LAND


def test_an_override_time_of_zero_switches_overrides_off(hands):
    hands.autopilot.parameters.set("RC_OVERRIDE_TIME", 0)
    hands.send(0.1)
    hands.autopilot.override((1600,), hands.world.time_s)
    hands.send(0.1)
    assert hands.autopilot.channels_us[0] == 1500


# ------------------------------------------------------------------ floor and net


def test_a_hard_landing_is_a_crash(flyer):
    flyer.fly_to(2.0)
    flyer.send(3.0, throttle=LOWEST_US, until=lambda: flyer.world.crashes)
    assert flyer.world.crashes and flyer.world.crashes[0].reason.startswith("hit the floor")
    assert not flyer.autopilot.armed and flyer.vehicle.phase is FlightPhase.LANDED


def test_in_the_net_its_motors_stop(flyer):
    flyer.send(8.0, pitch=1400, throttle=functools.partial(flyer.keep, 1.0), until=lambda: flyer.world.crashes)
    assert [crash.reason for crash in flyer.world.crashes] == ["flew into the net"] and not flyer.autopilot.armed
    flyer.send(2.0)
    assert flyer.vehicle.phase is FlightPhase.LANDED


def test_it_touches_down_softly_by_the_throttle_and_takes_off_again(flyer):
    flyer.send(8.0, throttle=lambda: flyer.keep(flyer.vehicle.height_m - 0.2), until=lambda: not flyer.autopilot.lifted)
    assert flyer.vehicle.phase is FlightPhase.LANDED and flyer.autopilot.armed and not flyer.world.crashes
    flyer.fly_to(1.0)
    assert flyer.vehicle.height_m == pytest.approx(1.0, abs=0.05)
