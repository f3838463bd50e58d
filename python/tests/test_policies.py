"""User-defined policies run behind the safety envelope, and are judged like any controller."""

import numpy as np
import pytest

import eupnea
from eupnea import _native
from eupnea.policies import Agent, Known, Lesson

SHORT = {"pips": [20], "breaths": 1, "seed": 1}


def proportional(seen):
    pressure, target, *_ = seen
    return float(np.clip(12 + 2 * (target - pressure), 0, 100))


def test_a_function_is_judged_like_any_controller():
    result = eupnea.evaluate(policy=proportional, **SHORT)
    assert 0.5 < result["mean"]["learned"]["score"] < 8
    again = eupnea.evaluate(policy=proportional, **SHORT)
    assert again["mean"] == result["mean"]


def test_a_policy_that_commands_no_percentage_is_contained():
    with_pid = eupnea.evaluate(gains=(3, 30), **SHORT)["mean"]["pid"]["score"]
    # After 50 ms its commands are no percentages.
    result = eupnea.evaluate(policy=lambda seen: 1e300 if seen[5] > 0.05 else 30.0, **SHORT)
    assert result["mean"]["learned"]["score"] < 3 * with_pid


def test_a_policy_that_fails_leaves_the_pid_and_is_named():
    def fails(seen):
        raise ZeroDivisionError

    with pytest.raises(RuntimeError, match="ZeroDivisionError"):
        eupnea.evaluate(policy=fails, **SHORT)


@pytest.mark.parametrize("failure", [ZeroDivisionError, TimeoutError])
def test_a_policy_that_fails_later_has_a_score_and_a_warning(failure):
    def fails(seen):
        if seen[5] > 0.5:
            raise failure
        return np.array([proportional(seen)])

    with pytest.warns(RuntimeWarning, match=failure.__name__):
        result = eupnea.evaluate(policy=fails, **SHORT)
    assert result["mean"]["learned"]["score"] > 0


def varied(step):
    """The action of a step: the command stays within 25 percent of that of the step before, which no limit changes."""
    return -0.7 + 0.2 * np.sin(0.9 * step)


@pytest.mark.parametrize("hold", [1, 7, 10])
@pytest.mark.parametrize("observation", ["ours", "authors", "plain"])
def test_an_agent_sees_and_commands_the_same_as_in_the_environment(observation, hold):
    # Two breaths, so that the second one has a past.
    environment = eupnea.PressureControl(lungs="R20C20", observation=observation, hold=hold, breaths=2)
    seen, _ = environment.reset(seed=1, options={"pip": 20, "noise": _native.noise_seeds("evaluate", 1)[0]})
    expected = []
    for step in range(environment.steps):
        expected.append(seen)
        seen, *_ = environment.step(varied(step))

    observed, commands = [], []

    def act(observation):
        observed.append(observation)
        return varied(len(observed) - 1)

    agent = Agent(act, observation=observation, hold=hold)

    def policy(seen):
        commands.append(agent(seen))
        return commands[-1]

    result = eupnea.evaluate(policy=policy, gains=(0, 0), bench="R20C20", pips=[20], breaths=2, seed=1)
    np.testing.assert_array_equal(observed[: environment.steps], expected)
    actions = np.array([varied(step) for step in range(environment.steps)], np.float32).reshape(2, -1)
    held = np.repeat(np.float32(100) * (np.float32(0.5) + np.float32(0.5) * actions), hold, axis=1)[:, :1000]
    np.testing.assert_array_equal(commands[:2000], held.ravel())
    assert result["policy"]["commanded"] == result["policy"]["ticks"]


def test_values_that_are_not_policies_are_refused(tmp_path):
    with pytest.raises(ValueError, match="function of six numbers"):
        eupnea.evaluate(policy=3)
    (tmp_path / "a.onnx").write_bytes(b"nothing")
    with pytest.raises((ValueError, ImportError), match="onnx"):
        eupnea.policies.onnx(tmp_path / "a.onnx")


def test_a_known_controller_has_the_scores_of_evaluate():
    gains = (3, 30)
    known = Known(eupnea.Controller.pid(gains))
    # Other gains underneath give other scores, so that the scores are those of the policy.
    result = eupnea.evaluate(policy=known, gains=(2, 10), **SHORT)
    alone = eupnea.evaluate(gains=gains, **SHORT)["mean"]["pid"]
    assert result["mean"]["learned"] == alone
    assert result["mean"]["pid"]["score"] != alone["score"]
    assert result["policy"]["commanded"] == result["policy"]["ticks"] > 0


def test_a_learned_controller_learns_over_the_link_as_it_does_in_evaluate():
    adult = eupnea.Controller.load("adult")
    options = {"pips": [15, 30], "breaths": 2, "seed": 1}
    result = eupnea.evaluate(policy=Known(adult), gains=adult.gains, breaths_of_learning=3, **options)
    alone, without = (eupnea.evaluate("adult", breaths_of_learning=breaths, **options) for breaths in (3, 0))
    assert result["mean"] == alone["mean"]
    assert result["mean"]["learned"]["score"] < 0.98 * without["mean"]["learned"]["score"]
    assert result["policy"]["pid"] == 0


def test_a_learned_controller_is_judged_almost_alike_where_its_commands_reach_the_end_of_the_valve():
    # The PID under a policy does not know of that, and the limit of the slew is relative to that PID.
    adult = eupnea.Controller.load("adult")
    options = {"bench": "R5C50", "pips": [15], "breaths": 2, "breaths_of_learning": 3, "seed": 1}
    found = eupnea.evaluate(policy=Known(adult), gains=adult.gains, **options)["mean"]["learned"]["score"]
    assert found == pytest.approx(eupnea.evaluate("adult", **options)["mean"]["learned"]["score"], rel=1e-3)


@pytest.mark.parametrize("action", [float("nan"), float("inf"), float("-inf")])
def test_an_action_that_is_not_finite_gives_no_command(action):
    agent = Agent(lambda seen: np.array([action]), hold=1)
    assert np.isnan(agent(np.array([5, 20, 20, 5, 0, 0], np.float32)))


def test_an_agent_needs_a_control_period():
    for observation in ("ours", "authors", "plain"):
        with pytest.raises(ValueError, match="period_us is 0"):
            Agent(lambda seen: 0.0, observation=observation, period_us=0)


@pytest.mark.parametrize("hold", [0, -1, 2.5, None, True, "10", float("nan")])
def test_an_agent_needs_a_whole_number_of_ticks_to_hold(hold):
    with pytest.raises(ValueError, match="whole number of control ticks"):
        Agent(lambda seen: 0.0, hold=hold)


class Heard:
    """A policy that keeps what it is told."""

    def __init__(self):
        self.events, self.last = [], []

    def reset(self):
        self.events.append("reset")

    def start(self, rise_time):
        self.events.append("start")
        self.rise_time = rise_time

    def learn(self, lesson, applied):
        self.events.append((lesson, applied))

    def __call__(self, seen):
        if self.events[-1] != "command":
            self.events.append("command")
        self.last.append(float(seen[4]))
        return proportional(seen)


def test_a_policy_hears_of_ventilations_breaths_and_lessons():
    heard = Heard()
    eupnea.evaluate(policy=heard, pips=[20], breaths=2, seed=1)
    breath = ["start", "command"]
    # The third breath has other settings, so the policy must forget.
    ventilation = ["reset", *breath, Lesson.ADOPT, *breath, Lesson.ADOPT, Lesson.FORGET, *breath]
    events = [event if isinstance(event, str) else event[0] for event in heard.events]
    assert events == ventilation * events.count("reset")
    assert all(isinstance(event, (str, Lesson)) for event in events)
    # The command of the last tick of a breath is near that of the tick before.
    applied = [event[1] for event in heard.events if not isinstance(event, str) and event[0] is Lesson.ADOPT]
    before = np.array(heard.last[999::1000]).reshape(-1, 3)[:, :2]
    np.testing.assert_allclose(applied, before.ravel(), atol=2)


def test_a_policy_hears_of_the_rise_and_a_learned_controller_uses_it():
    heard = Heard()
    options = {"settings": {"rise_time": 0.3}, "pips": [15], "breaths": 1, "seed": 1}
    eupnea.evaluate(policy=heard, **options)
    assert heard.rise_time == pytest.approx(0.3)
    adult = eupnea.Controller.load("adult")

    class Deaf(Known):
        def start(self, rise_time):
            super().start(0.0)

    def score(policy):
        return eupnea.evaluate(policy=policy, gains=adult.gains, **options)["mean"]["learned"]["score"]

    # The PID under a policy does not know where the policy's command reaches the fully open valve: here it never does.
    alone = eupnea.evaluate("adult", **options)["mean"]["learned"]["score"]
    assert score(Known(adult)) == pytest.approx(alone, rel=1e-3)
    assert score(Deaf(adult)) > 1.02 * alone


def test_a_policy_hears_that_the_limit_ended_a_breath():
    class Opens(Heard):
        def __call__(self, seen):
            super().__call__(seen)
            return 100.0

    heard = Opens()
    result = eupnea.evaluate(policy=heard, pips=[35], breaths=1, seed=1)
    assert result["mean"]["learned"]["cut"] > 0
    assert Lesson.DISCARD in [event[0] for event in heard.events if isinstance(event, tuple)]


def test_an_exception_of_an_optional_method_is_a_failure_of_the_policy():
    class Fails(Heard):
        def learn(self, lesson, applied):
            raise LookupError

    with pytest.warns(RuntimeWarning, match="LookupError"):
        eupnea.evaluate(policy=Fails(), **SHORT)


def with_period(period_us):
    def policy(seen):
        return proportional(seen)

    policy.period_us = period_us
    return policy


@pytest.mark.parametrize("policy", [Agent(lambda seen: -0.6, period_us=2000), Known(eupnea.Controller.pid((3, 30), period_us=2000))])
def test_the_trainer_uses_the_control_period_of_a_policy_and_refuses_another(policy):
    assert eupnea.evaluate(policy=policy, **SHORT)["period_us"] == 2000
    with pytest.raises((RuntimeError, ValueError), match="2000 us, not 1000"):
        eupnea.evaluate(policy=policy, period_us=1000, **SHORT)


def test_a_function_may_have_a_control_period():
    assert eupnea.evaluate(policy=with_period(2000), **SHORT)["period_us"] == 2000
    assert eupnea.evaluate(policy=with_period(0), period_us=2000, **SHORT)["period_us"] == 2000
    assert eupnea.evaluate(policy=proportional, period_us=2000, **SHORT)["period_us"] == 2000
    for wrong in (-1, 1.5, "1000", 2**32):
        with pytest.raises(ValueError, match="whole number of microseconds"):
            eupnea.evaluate(policy=with_period(wrong), **SHORT)


@pytest.mark.parametrize("command", [eupnea.evaluate, eupnea.robust])
def test_an_address_that_is_empty_is_refused(command):
    for empty in ("", " "):
        with pytest.raises(ValueError, match="function of six numbers, or an address"):
            command(policy=empty)


def test_a_lesson_has_the_number_of_the_link():
    controller = eupnea.Controller.load("adult")
    for wrong in (3, 7):
        with pytest.raises(ValueError, match="0 adopts, 1 discards, 2 forgets"):
            controller.learn(wrong)
    pressures, targets = np.linspace(5, 19, 300, dtype=np.float32), np.full(300, 20, np.float32)

    def breathe():
        controller.start_breath()
        return controller(pressures, targets)

    first = breathe()
    controller.learn(Lesson.DISCARD)
    np.testing.assert_array_equal(breathe(), first)
    controller.learn(Lesson.ADOPT)
    learned = breathe()
    assert not np.array_equal(learned, first)
    controller.learn(Lesson.FORGET)
    np.testing.assert_array_equal(breathe(), first)


def test_a_controller_takes_the_command_that_the_valve_had():
    def last_command(applied):
        controller = eupnea.Controller.load("adult")
        controller.start_breath()
        commands = [controller.step(8, 20, applied=applied) for _ in range(50)]
        return commands[-1]

    assert last_command(None) != last_command(5.0)
