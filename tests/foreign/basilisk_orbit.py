"""Basilisk: a rigid satellite on a circular orbit. `basilisk_orbit.py IN.npz OUT.npz`.

In: `body` (inertia about the centre of mass), `mass`; `mu` of the planet, `orbit` (place and
velocity of the point on the orbit), `start` (place and velocity from it), `omega`; `step`,
`until`, `every` [s].
Out: `path` (n, 7), place of the centre of mass in space and quaternion.
"""

import sys

import numpy as np
from Basilisk.simulation import GravityGradientEffector, spacecraft, svIntegrators
from Basilisk.utilities import (
    RigidBodyKinematics,
    SimulationBaseClass,
    macros,
    simIncludeGravBody,
)


def column(vector):
    """A vector as Basilisk takes it."""
    return [[float(k)] for k in vector]


def main(given):
    """Fly until the end."""
    craft = spacecraft.Spacecraft()
    craft.ModelTag = "craft"
    craft.setIntegrator(svIntegrators.svIntegratorRK4(craft))
    craft.hub.mHub, craft.hub.IHubPntBc_B = float(given["mass"]), given["body"].tolist()
    craft.hub.r_BcB_B = column(np.zeros(3))
    at, moving = given["orbit"] + given["start"]
    craft.hub.r_CN_NInit, craft.hub.v_CN_NInit = column(at), column(moving)
    craft.hub.sigma_BNInit = column(np.zeros(3))
    craft.hub.omega_BN_BInit = column(given["omega"])
    bodies = simIncludeGravBody.gravBodyFactory()
    earth = bodies.createEarth()
    earth.isCentralBody, earth.mu = True, float(given["mu"])
    bodies.addBodiesTo(craft)
    gradient = GravityGradientEffector.GravityGradientEffector()
    gradient.ModelTag = "gradient"
    gradient.addPlanetName(earth.planetName)
    craft.addDynamicEffector(gradient)
    simulation = SimulationBaseClass.SimBaseClass()
    task = simulation.CreateNewTask("t", macros.sec2nano(float(given["step"])))
    simulation.CreateNewProcess("p").addTask(task)
    simulation.AddModelToTask("t", craft)
    simulation.AddModelToTask("t", gradient)
    simulation.InitializeSimulation()
    out, every = [], float(given["every"])
    for k in range(round(float(given["until"]) / every)):
        simulation.ConfigureStopTime(macros.sec2nano((k + 1) * every))
        simulation.ExecuteSimulation()
        state = craft.scStateOutMsg.read()
        out.append([*state.r_BN_N, *RigidBodyKinematics.MRP2EP(np.array(state.sigma_BN))])
    return np.array(out)


if __name__ == "__main__":
    np.savez(sys.argv[2], path=main(dict(np.load(sys.argv[1]))))
