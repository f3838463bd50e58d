"""The data set for Minari: loaded with Minari, and repeated in the environment that it names."""

import os
import sys

import numpy as np
import pytest

import eupnea
from eupnea import __main__, reference
from eupnea._native import KNOWN_GOOD
from eupnea.policies import Known

minari = pytest.importorskip("minari")

EPISODES = 6
NAME = "eupnea/adult-family/pid-exploration-v0"


def make(folder, *arguments):
    assert __main__.main(["minari", "--out", str(folder), "--episodes", str(EPISODES), *arguments]) == 0
    return folder


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    return make(tmp_path_factory.mktemp("minari"), "--seed", "4")


def load(folder, monkeypatch):
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(folder))
    return minari.load_dataset(NAME)


@pytest.fixture
def data_set(place, monkeypatch):
    return load(place, monkeypatch)


def test_minari_lists_it_with_what_it_is(data_set, place):
    assert list(minari.list_local_datasets()) == [NAME]
    metadata = data_set.storage.metadata
    assert metadata["algorithm_name"] and metadata["description"] and metadata["author"] and metadata["code_permalink"]
    assert data_set.total_episodes == EPISODES == len(data_set)
    assert data_set.total_steps == sum(len(episode) for episode in data_set)
    # Nothing unfinished is left.
    assert [path.name for path in place.iterdir()] == ["eupnea"]


def test_an_episode_can_be_repeated_in_the_recovered_environment(data_set, recwarn):
    environment = data_set.recover_environment()
    assert not [str(warning.message) for warning in recwarn], "the requirements are met"
    assert environment.spec.id == "eupnea/AdultFamily-v0"
    for episode, about in zip(data_set, data_set.storage.get_episode_metadata(data_set.episode_indices), strict=True):
        observation, info = environment.reset(seed=about["seed"], options=about["options"])
        np.testing.assert_array_equal(episode.observations[0], observation)
        for step, action in enumerate(episode.actions):
            observation, reward, terminated, truncated, end = environment.step(action)
            np.testing.assert_array_equal(episode.observations[step + 1], observation)
            assert (episode.rewards[step], episode.terminations[step], episode.truncations[step]) == (reward, terminated, truncated)
        assert terminated and (info["plant"], end["fault"]) == (about["plant"], about["fault"])
        assert about["settings"] == environment.unwrapped.settings


def test_settings_plants_and_actions_vary(data_set):
    about = list(data_set.storage.get_episode_metadata(data_set.episode_indices))
    for name in ("pip", "peep", "inspiratory_time", "rate"):
        assert len({each["settings"][name] for each in about}) == EPISODES
    assert len({each["plant"] for each in about}) == EPISODES
    assert all(np.unique(episode.actions).size > 10 for episode in data_set)


def test_an_action_is_the_command_of_the_known_good_pid_with_a_perturbation(data_set):
    environment = data_set.recover_environment(observation="plain").unwrapped
    pid = Known(eupnea.Controller.pid(KNOWN_GOOD, period_us=10_000), as_action=True)
    perturbed = 0
    for episode, about in zip(data_set, data_set.storage.get_episode_metadata(data_set.episode_indices), strict=True):
        seen, _ = environment.reset(seed=about["seed"], options=about["options"])
        pid.reset()
        # One value per tick of 1 ms, percent of the valve, of which 50 are an action of 1.
        for action, percent in zip(episode.actions, environment.exploration(about["seed"])[::10], strict=True):
            assert action == pytest.approx(np.clip(pid(seen) + percent / 50, -1, 1), abs=1e-5)
            perturbed += percent != 0
            seen, *_ = environment.step(action)
    assert perturbed > 0.05 * data_set.total_steps


def test_episodes_are_sampled_and_scores_normalized(data_set):
    data_set.set_seed(1)
    sampled = data_set.sample_episodes(3)
    assert len({episode.id for episode in sampled}) == 3
    assert all(episode.observations.shape == (len(episode) + 1, 25) for episode in sampled)
    least, most = reference.returns("eupnea/AdultFamily-v0", "bedside")
    np.testing.assert_allclose(minari.get_normalized_score(data_set, np.array([least, most])), [0, 1])


def test_the_same_seed_gives_the_same_data_and_another_seed_other_data(place, tmp_path, monkeypatch):
    data = "**/[0-9]*/*.arrow"

    def files(folder):
        return [path.read_bytes() for path in sorted(folder.glob(data))]

    assert len(files(place)) == EPISODES
    assert files(make(tmp_path / "again", "--seed", "4")) == files(place)
    other = make(tmp_path / "other", "--seed", "5")
    assert not set(files(other)) & set(files(place))


def test_a_data_set_is_not_replaced(place, capsys):
    with pytest.raises(SystemExit) as exit:
        make(place)
    assert exit.value.code == 1 and "exists already" in capsys.readouterr().err


def test_ctrl_c_leaves_nothing(tmp_path):
    from eupnea import minari as ours

    def interrupt(stage, done, total):
        if done == 2:
            raise KeyboardInterrupt

    before = os.environ.get("MINARI_DATASETS_PATH")
    with pytest.raises(KeyboardInterrupt):
        ours.record(tmp_path, episodes=EPISODES, progress=interrupt)
    assert not list(tmp_path.iterdir()) and os.environ.get("MINARI_DATASETS_PATH") == before


def test_a_missing_minari_is_named_with_the_extra_that_installs_it(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "minari", None)
    monkeypatch.delitem(sys.modules, "eupnea.minari", raising=False)
    monkeypatch.delattr(eupnea, "minari", raising=False)
    with pytest.raises(SystemExit) as exit:
        make(tmp_path)
    assert exit.value.code == 1 and "pip install './python[minari]'" in capsys.readouterr().err
