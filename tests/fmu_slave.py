"""An FMU in co-simulation, stepped by calls of its functions."""

import numpy as np
from exported_scenes import STEP


class Slave:
    """An FMU in co-simulation by FMPy's calls of its functions, as an importing program makes them."""

    def __init__(self, fmpy, path, folder):
        from fmpy import fmi2, fmi3

        self.description = fmpy.read_model_description(path)
        self.old = self.description.fmiVersion == "2.0"
        self.folder = fmpy.extract(path, folder)
        kind = fmi2.FMU2Slave if self.old else fmi3.FMU3Slave
        identifier = self.description.coSimulation.modelIdentifier
        self.fmu = kind(
            guid=self.description.guid, unzipDirectory=self.folder, modelIdentifier=identifier, instanceName="one"
        )
        self.fmu.instantiate()

    def references(self, causality):
        return [v.valueReference for v in self.description.modelVariables if v.causality == causality]

    def put(self, values):
        (self.fmu.setReal if self.old else self.fmu.setFloat64)(self.references("input"), values)

    def outputs(self):
        return np.array((self.fmu.getReal if self.old else self.fmu.getFloat64)(self.references("output")))

    def start(self, values):
        if self.old:
            self.fmu.setupExperiment(startTime=0.0)
        self.fmu.enterInitializationMode()
        self.put(values)
        self.fmu.exitInitializationMode()

    def run(self, inputs, first=0):
        """Go through inputs, (inputs, n), and return the outputs, (outputs, n)."""
        found = []
        for k, values in enumerate(inputs.T, start=first):
            self.put(-values)  # as by a program that iterates
            self.outputs()
            self.put(values)
            found.append(self.outputs())
            self.fmu.doStep(k * STEP, STEP)
        return np.array(found).T

    def end(self):
        self.fmu.terminate()
        self.fmu.freeInstance()
