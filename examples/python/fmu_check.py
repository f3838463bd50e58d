"""Runs an FMU of `trainer export` in fmpy and compares it with a recording of `trainer collect` (docs/C_EXPORT.md); needs fmpy.

  python3 fmu_check.py adult.fmu recording.parquet

The recording must be of the same controller on the same bench, without exploration. Every tick must have the same bits.
"""

import sys

import numpy as np
import pyarrow.parquet as pq
from fmpy import extract, read_model_description
from fmpy.fmi2 import FMU2Slave
from fmpy.validation import validate_fmu

COLUMNS = ["target", "pressure", "u_in", "u_out"]


def main(fmu: str, recording: str) -> None:
    if problems := validate_fmu(fmu):
        sys.exit(f"{fmu} breaks the standard: {problems}")
    table = pq.read_table(recording)
    recorded = np.stack([table[name].to_numpy() for name in COLUMNS], axis=1).astype(np.float32)
    given = run(fmu, table["pip"].to_numpy(), table["tick"].to_numpy())
    wrong = np.flatnonzero((given.view(np.uint32) != recorded.view(np.uint32)).any(axis=1))
    if len(wrong):
        sys.exit(f"{len(wrong)} of {len(given)} ticks differ, first {wrong[0]}: {given[wrong[0]]}, recorded {recorded[wrong[0]]}")
    if not np.ptp(recorded[:, COLUMNS.index("pressure")]) > 5.0:
        sys.exit("the pressure hardly moves, so the comparison proves nothing")
    print(f"{fmu}: {len(given)} ticks have the bits of {recording}")


def run(fmu: str, pips: np.ndarray, ticks: np.ndarray) -> np.ndarray:
    """Outputs of the FMU in every tick, with the PIP of each breath set at its start."""
    description = read_model_description(fmu)
    references = {variable.name: variable.valueReference for variable in description.modelVariables}
    step = float(description.defaultExperiment.stepSize)
    slave = FMU2Slave(
        guid=description.guid,
        unzipDirectory=extract(fmu),
        modelIdentifier=description.coSimulation.modelIdentifier,
        instanceName="ventilator",
    )
    slave.instantiate()
    slave.setupExperiment(startTime=0.0)
    slave.enterInitializationMode()
    slave.setReal([references["pip"]], [float(pips[0])])
    slave.exitInitializationMode()
    outputs = [references[name] for name in COLUMNS]
    given = np.empty((len(pips), len(COLUMNS)), np.float32)
    for number, (pip, tick) in enumerate(zip(pips, ticks, strict=True)):
        if tick == 0:
            slave.setReal([references["pip"]], [float(pip)])
        slave.doStep(currentCommunicationPoint=number * step, communicationStepSize=step)
        given[number] = slave.getReal(outputs)
    slave.terminate()
    slave.freeInstance()
    return given


if __name__ == "__main__":
    main(*sys.argv[1:])
