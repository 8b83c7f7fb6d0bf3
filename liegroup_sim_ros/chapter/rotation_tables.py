# SPDX-License-Identifier: Apache-2.0
"""Results of independent implementations of the rotation methods for the chapter's two problems.

Double precision; exact end states by Taylor series with 45 digits. None: no solution at this step.
Names of methods are those of METHODS.
"""
import numpy as np

FREE_R_10 = np.array([
    [0.19178161690691239, 0.77079260376254685, -0.60753483307669178],
    [0.85411011090955504, -0.436001649248976, -0.28354625776800601],
    [-0.48344154750976658, -0.46452268387789887, -0.74195885755494269]])
TOP_R_1 = np.array([
    [0.22929964080360759, 0.17334396409838604, 0.95779619170155087],
    [-0.76534074220468094, 0.64008859207056878, 0.067380580456872719],
    [-0.60139439891715374, -0.74849079113358131, 0.27943928238402867]])

# |Y - Y0| at 16 s, N m s, free body: Figs. 6.6 and 6.8. Columns per h.
MOMENTUM_STEPS = (8, 4, 2, 1, 1/2, 1/4, 1/8, 1/16, 1/64, 1/256, 1/1024, 1/4096)
MOMENTUM = {
    "stoermer_verlet": (3.7e-16, 1.3e-16, 3.2e-16, 5.3e-16, 6.4e-16, 4.7e-16, 2.3e-15, 1.4e-15,
                        1.8e-15, 4.1e-15, 3.8e-15, 3.4e-14),
    "lie_newmark": (1.053, 1.265e-1, 1.906e-2, 4.421e-3, 1.091e-3, 2.720e-4, 6.795e-5, 1.698e-5,
                    1.062e-6, 6.634e-8, 4.146e-9, 2.591e-10),
    "rkmk4": (1.355, 8.227e-2, 1.352e-3, 1.469e-4, 1.084e-5, 7.238e-7, 4.659e-8, 2.953e-9,
              1.165e-11, 4.584e-14, 3.8e-15, 1.9e-14),
    "coadjoint_rkmk2": (2.8e-16, 4.8e-16, 1.7e-16, 3.2e-16, 8.3e-16, 5.7e-16, 6.1e-16, 6.6e-16,
                        5.2e-15, 6.1e-15, 9.1e-15, 3.5e-14),
    "coadjoint_rkmk4": (6.7e-16, 7.2e-16, 6.6e-16, 4.7e-16, 8.2e-16, 6.3e-16, 7.6e-16, 1.8e-15,
                        3.8e-15, 8.6e-15, 1.1e-14, 2.2e-14),
    "simo_wong": (1.6e-16, None, 1.2e-16, 2.4e-16, 2.1e-16, 5.9e-16, 7.5e-16, 1.2e-15, 4.3e-15,
                  7.0e-15),
    "austin_krishnaprasad_wang": (2.0e-16, 6.0e-16, 3.1e-16, 5.7e-16, 2.8e-16, 2.0e-15, 5.3e-16,
                                  1.2e-15, 2.4e-15, 8.2e-15),
    "rattle": (None, None, None, 7.0e-16, 3.1e-16, 1.3e-15, 1.0e-15, 3.1e-15, 2.7e-15, 7.9e-15),
}

# ||R(1) - Rref||_2, Lagrangian top: Fig. 6.7. Columns per 1/h.
TOP_RATES = (64, 128, 256, 512, 1024, 2048, 4096, 8192, 16384, 32768, 65536)
TOP_ATTITUDE = {
    "stoermer_verlet": (1.716, 2.000, 5.401e-1, 1.0297e-1, 2.1462e-2, 4.8291e-3, 1.1404e-3,
                        2.7675e-4, 6.8146e-5, 1.6907e-5, 4.2104e-6),
    "lie_newmark": (1.576, 1.446, 1.331, 4.927e-1, 1.2828e-1, 3.2263e-2, 8.0759e-3, 2.0196e-3,
                    5.0493e-4, 1.2623e-4, 3.1559e-5),
    "rattle": (None, None, 1.817, 1.799, 5.362e-1, 1.3461e-1, 3.3614e-2, 8.4001e-3, 2.0998e-3,
               5.2493e-4, 1.3123e-4),
    "rkmk4": (1.628, 1.430, 1.353e-1, 6.173e-3, 3.1337e-4, 1.7658e-5, 1.0520e-6, 6.4306e-8,
              3.9768e-9, 2.4729e-10, 1.5423e-11),
    "lie_midpoint": (1.985, 8.777e-1, 2.306e-1, 5.803e-2, 1.4524e-2, 3.6320e-3, 9.0806e-4,
                     2.2702e-4, 5.6755e-5, 1.4189e-5, 3.5472e-6),
    "simo_wong": (1.959, 9.147e-1, 2.630e-1, 6.732e-2, 1.6913e-2, 4.2332e-3, 1.0586e-3, 2.6467e-4,
                  6.6169e-5, 1.6542e-5, 4.1356e-6),
    # With y_m = (y + y+)/2; the method here takes y_m from the first half kick
    # (docs/explanation/figures.md).
    "austin_krishnaprasad_wang": (1.985, 1.813, 1.753, 1.033, 2.7347e-1, 6.8746e-2, 1.7201e-2,
                                  4.3009e-3, 1.0753e-3, 2.6882e-4, 6.7205e-5),
}

# ||R(10) - Rref||_2, free body: Fig. 6.9. Columns per h.
FREE_STEPS = (2, 1, 1/2, 1/4, 1/16, 1/64, 1/256)
FREE_ATTITUDE = {
    "stoermer_verlet": (5.2559e-1, 2.2543e-1, 6.8439e-2, 1.8392e-2, 1.2008e-3, 7.5777e-5,
                        4.7471e-6),
    "lie_newmark": (8.2432e-2, 2.0377e-2, 5.0871e-3, 1.2714e-3, 7.9459e-5, 4.9661e-6, 3.1038e-7),
    "rattle": (None, 1.9876, 4.1048e-1, 9.5058e-2, 5.8022e-3, 3.6210e-4, 2.2629e-5),
    "coadjoint_rkmk2": (2.8441e-1, 9.1814e-2, 2.5543e-2, 6.6897e-3, 4.3145e-4, 2.7165e-5,
                        1.7009e-6),
    "coadjoint_rkmk2_heun": (2.6975e-1, 9.6243e-2, 2.8891e-2, 7.8534e-3, 5.1977e-4, 3.2926e-5,
                             2.0647e-6),
    "coadjoint_rkmk4": (1.4580e-2, 1.4347e-3, 1.0809e-4, 7.3253e-6, 3.0219e-8, 1.1956e-10,
                        4.7753e-13),
    "rkmk4": (1.3341e-2, 8.5600e-4, 5.4309e-5, 3.4191e-6, 1.3426e-8, 5.2517e-11, 2.1006e-13),
    "simo_wong": (8.0155e-1, 1.8216e-1, 4.3292e-2, 1.0676e-2, 6.6436e-4, 4.1511e-5, 2.5944e-6),
    "austin_krishnaprasad_wang": (1.6677, 6.4657e-1, 1.8054e-1, 4.6359e-2, 2.9214e-3, 1.8268e-4,
                                  1.1418e-5),
    "bottasso_borri_candidate": (2.2145e-1, 4.9533e-2, 1.1886e-2, 2.9323e-3, 1.8203e-4, 1.1363e-5,
                                 7.0997e-7),
    "lie_midpoint": (2.6858e-1, 6.7839e-2, 1.6944e-2, 4.2340e-3, 2.6458e-4, 1.6536e-5, 1.0335e-6),
}

# (order from the last two errors above round-off, C = error / h^order at the last one).
TOP_CONSTANTS = {
    "stoermer_verlet": (2.01, 1.808e4), "lie_newmark": (2.00, 1.355e5), "rattle": (2.00, 5.636e5),
    "rkmk4": (4.00, 2.845e8), "lie_midpoint": (2.00, 1.524e4), "simo_wong": (2.00, 1.776e4),
    "austin_krishnaprasad_wang": (2.00, 2.886e5),
}
FREE_CONSTANTS = {
    "stoermer_verlet": (2.00, 0.3111), "lie_newmark": (2.00, 0.02034), "rattle": (2.00, 1.483),
    "coadjoint_rkmk2": (2.00, 0.1115), "coadjoint_rkmk2_heun": (2.00, 0.1353),
    "coadjoint_rkmk4": (3.98, 2.01e-3), "rkmk4": (4.00, 8.81e-4), "simo_wong": (2.00, 0.1700),
    "austin_krishnaprasad_wang": (2.00, 0.7483), "bottasso_borri_candidate": (2.00, 0.0465),
    "lie_midpoint": (2.00, 0.0677),
}

# Lagrangian top over 10 s: largest deviations of energy, J, vertical momentum, N m s, and spin,
# rad/s, at h = 1e-3 and 5e-4. None: below 1e-11.
TOP_INTEGRALS = {
    ("stoermer_verlet", 1e-3): (6.92, None, 9.99e-2),
    ("stoermer_verlet", 5e-4): (0.880, None, 1.25e-2),
    ("lie_newmark", 1e-3): (1.05, 3.77, None), ("lie_newmark", 5e-4): (0.263, 0.947, None),
    ("rattle", 1e-3): (2.69e-2, None, None), ("rattle", 5e-4): (6.7e-3, None, None),
    ("rkmk4", 1e-3): (2.97e-1, 2.99e-2, None), ("rkmk4", 5e-4): (9.3e-3, 1.2e-3, None),
}
