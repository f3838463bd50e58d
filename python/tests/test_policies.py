"""Policies of one's own are judged behind the safety envelope."""

import numpy as np
import pytest

import eupnea
from eupnea.policies import Agent

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


def test_an_agent_sees_and_commands_what_it_did_in_the_environment():
    seen = []

    def act(observation):
        seen.append(observation)
        return -0.6

    eupnea.evaluate(policy=Agent(act, observation="authors", hold=100), gains=(0, 0), **SHORT)
    assert seen and len(seen) % 10 == 0 and all(observation.shape == (10,) for observation in seen)


def test_what_is_no_policy_is_refused(tmp_path):
    with pytest.raises(ValueError, match="function of six numbers"):
        eupnea.evaluate(policy=3)
    (tmp_path / "a.onnx").write_bytes(b"nothing")
    with pytest.raises((ValueError, ImportError), match="onnx"):
        eupnea.policies.onnx(tmp_path / "a.onnx")


def test_a_known_controller_has_the_scores_of_evaluate():
    gains = (3, 30)
    known = eupnea.policies.Known(eupnea.Controller.pid(gains))
    # The PID that lies under the policy is the same, so nothing can differ.
    result = eupnea.evaluate(policy=known, gains=gains, **SHORT)
    alone = eupnea.evaluate(gains=gains, **SHORT)["mean"]["pid"]["score"]
    assert result["mean"]["learned"]["score"] == alone == result["mean"]["pid"]["score"]


def test_an_agent_needs_a_control_period():
    for observation in ("ours", "authors", "plain"):
        with pytest.raises(ValueError, match="period_us is 0"):
            Agent(lambda seen: 0.0, observation=observation, period_us=0)
