"""FMUs of controllers, stepped by FMPy as a simulation tool does it."""

import shutil
from typing import Any, NamedTuple

import numpy as np
import pytest

from npred import exports
from npred.exports import WholeController, fmu

needs_cc = pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler on this machine")


class Measured:
    """A controller that takes one u, as an FMU does: no values at the nodes beside the means."""

    def __init__(self, controller):
        self.controller = controller

    def step(self, X, *measured):
        return self.controller.step(X, *measured[:1])


class Written(NamedTuple):
    variables: list[fmu.Variable]
    facts: dict[str, Any]


class InFmu:
    """One instance of an FMU, with the calls of npred.controller: set X, doStep, get U."""

    def __init__(self, path, folder, written, dt, start=0.0, **parameters):
        fmpy = pytest.importorskip("fmpy")
        from fmpy.fmi2 import FMU2Slave
        from fmpy.fmi3 import FMU3Slave

        self.description = fmpy.read_model_description(str(path))
        self.version = int(self.description.fmiVersion[0])
        if not folder.exists():
            fmpy.extract(str(path), str(folder))
        kind = FMU2Slave if self.version == 2 else FMU3Slave
        self.messages = []
        self.slave = kind(
            guid=self.description.guid, unzipDirectory=str(folder),
            modelIdentifier=self.description.coSimulation.modelIdentifier, instanceName="one",
        )  # fmt: skip
        self._instantiate()
        self.places, self.blocks = {}, {}
        for reference, variable in enumerate(written.variables):
            self.places[variable.name] = reference
            self.blocks.setdefault(variable.block, []).append(reference)
        self.t, self.dt = start, dt
        for name, value in parameters.items():
            self.set(name, value)
        self._initialize(start)

    def _instantiate(self):
        if self.version == 3:
            self.slave.instantiate(logMessage=lambda _, status, category, text: self.messages.append(text.decode()))
            return
        from fmpy import fmi2

        def log(environment, name, status, category, text, *more):
            self.messages.append(more[0].decode() if more else text.decode())

        self.logger = fmi2.fmi2CallbackLoggerTYPE(log)
        functions = fmi2.fmi2CallbackFunctions()
        functions.logger = self.logger
        self.callbacks = functions
        self.slave.instantiate(callbacks=functions)

    def _initialize(self, start):
        if self.version == 3:
            self.slave.enterInitializationMode(startTime=start)
        else:
            self.slave.setupExperiment(startTime=start)
            self.slave.enterInitializationMode()
        self.slave.exitInitializationMode()

    def set(self, name, *values):
        self._write([self.places[name]], values)

    def get(self, name):
        (value,) = self._read([self.places[name]])
        return value

    def flag(self, name):
        read = self.slave.getBoolean
        return bool(read([self.places[name]])[0])

    def _write(self, references, values):
        self.slave.setReal(references, values) if self.version == 2 else self.slave.setFloat64(references, values)

    def _read(self, references):
        return self.slave.getReal(references) if self.version == 2 else self.slave.getFloat64(references)

    def step(self, X, *measured):
        """U of the control step now, after one communication step of dt."""
        self.offer(X, *measured)
        self.slave.doStep(self.t, self.dt)
        self.t = self.t + self.dt
        return np.array(self._read(self.blocks["U"]))

    def offer(self, X, *measured):
        self._write(self.blocks["X"], list(X))
        if "ACTUATOR" in self.blocks:
            self._write(self.blocks["ACTUATOR"], np.ravel(measured[0]).tolist())

    def state(self):
        """The FMU's state in bytes."""
        names = ("FMUstate", "DeSerialize") if self.version == 2 else ("FMUState", "Deserialize")
        state = getattr(self.slave, f"get{names[0]}")()
        serialized = getattr(self.slave, f"serialize{names[0]}")(state)
        getattr(self.slave, f"free{names[0]}")(state)
        return bytes(serialized)

    def restore(self, saved):
        name = "FMUstate" if self.version == 2 else "FMUState"
        deserialize = self.slave.deSerializeFMUstate if self.version == 2 else self.slave.deserializeFMUState
        state = deserialize(saved)
        try:
            getattr(self.slave, f"set{name}")(state)
        finally:
            getattr(self.slave, f"free{name}")(state)
        self.t = self.get("time")

    def close(self):
        self.slave.terminate()
        self.slave.freeInstance()


def exported(controller, folder, version=3, start=None, t_end=1.0, **options):
    """The path of the controller's FMU, its variables, and what the export says of it."""
    path = folder / f"controller{version}.fmu"
    of = WholeController(controller, X0=start, t_end=t_end)
    facts = exports.writer("fmu", {"fmi": version} | options)(of, path).facts
    return path, Written(fmu.variables(controller, np.zeros(controller.plant.n), version == 3), facts)
