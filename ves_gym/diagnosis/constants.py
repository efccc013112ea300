"""The numbers by which a diagnosis decides, each with its reason.

All of them weigh evidence: twice the log of a ratio of probabilities, as deviance is.
"""

# Chance that anything of the library is named where nothing is missing: one alarm in 200.
CHANCE = 0.005
# Below this difference in evidence two hypotheses are told as "one of": odds of 20 to 1.
ALIKE = 6.0
# Laws of a library are never quite a machine's, tolerances and noise not quite as told: the
# likelihood is coarsened (`evidence.py`), and deviations grow by the root.
TEMPERATURE = 2.0
# The noise that a log states is known to a factor of two in amplitude: less is no finding.
NOISE_POWER = 4.0
# Evidence against power that no law explains, on the runs held back where there are any.
EXCESS = 60.0
# Standard deviations at which an effect of its usual size must show, or two candidates are
# apart: 5, as in physics.
POWER = 5.0
# Standard deviations from which a number is clearly not zero.
CLEAR = 3.0
# Part of the noise's mean square that a model may leave: less is no finding.
QUIETEST = 0.05
# Errors of a description are as large as stated to a factor of three (standard deviation of
# the logarithm of their common scale), and at most ten times.
SCALE_SPREAD = 3.0
SCALE_MOST = 10.0
# Sizes that weights of a law without a name may have a priori [N m; hundredths of the base's].
SIZES = (0.0, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0)
# Joints at which a law without a name is looked for: those where most is unexplained.
OPEN_JOINTS = 3
# Evidence against laws that have no name: what is missing has one, 150 times of 151. With a
# bound that is lower they take over where a name explains as much.
OPEN = 10.0
# Parts of a number by which it may differ in each run and third, and those of another law.
SHARES = (0.0, 0.03, 0.1, 0.3, 1.0)
CHANGES = 0.3
# Chance that a part of a cause is there, such as a joint's where an arm rubs: the parts alone
# are names of the library, so few of them are no cause.
PRESENT = 0.9
