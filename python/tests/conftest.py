"""Fixtures of the tests: small recordings and simulators, made once."""

import pytest

import eupnea


@pytest.fixture(scope="session")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("eupnea")


@pytest.fixture(scope="session")
def recording(folder):
    return eupnea.collect(out=folder / "recording.parquet", breaths=12, seed=3)


@pytest.fixture(scope="session")
def simulator(folder, recording):
    path = folder / "simulator.safetensors"
    eupnea.fit(recording, out=path, epochs=20)
    return path


@pytest.fixture
def environment():
    return eupnea.PressureControl()
