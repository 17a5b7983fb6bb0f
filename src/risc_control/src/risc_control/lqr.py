"""Linear-quadratic regulators, checked (thesis 7.3: "infinite-horizon LQR").

All gains follow u = +K (x_reference - x), i.e. A - B K is stable (errata 6 and 7: the thesis prints a minus sign).
"""

import numpy as np
from scipy.linalg import LinAlgError, solve_continuous_are

_PIVOT = 1e-9  # a mode counts as out of reach when [lambda I - A, B] is this close to losing rank


def lqr_gain(A, B, Q, R):
    """Gain (m, n) that minimises the integral of x'Qx + u'Ru subject to x' = A x + B u.

    A: (n, n).  B: (n, m).  Q: (n, n) or its diagonal (n,), positive semidefinite.  R: (m, m) or its diagonal (m,),
    positive definite.  Raises ValueError that says which of them is wrong, or which mode no input reaches.
    """
    A, B = (np.array(matrix, dtype=float, ndmin=2) for matrix in (A, B))
    Q, R = (np.diag(weight) if np.ndim(weight) == 1 else np.array(weight, dtype=float, ndmin=2) for weight in (Q, R))
    try:
        weights, vectors = np.linalg.eigh(Q)
        if weights.min() < -_PIVOT * max(1.0, weights.max()):
            raise ValueError("LQR: Q has a negative eigenvalue: weights must be 0 or more")
        if np.linalg.eigvalsh(R).min() <= 0.0:
            raise ValueError("LQR: R must be positive: a free input would be infinite")
        _check_modes(A, B, lambda eigenvalue: eigenvalue.real >= -_PIVOT, "input reaches")
        root = vectors * np.sqrt(np.clip(weights, 0.0, None))
        _check_modes(A.T, root, lambda eigenvalue: abs(eigenvalue.real) <= _PIVOT, "weight in Q sees")
        return np.linalg.solve(R, B.T @ solve_continuous_are(A, B, Q, R))
    except LinAlgError as error:
        raise ValueError("LQR has no solution for these weights (%s)" % error) from error


def with_integral(A, B, C):
    """(A, B) of the plant with the integrals of y = C x as its first states: the plant of an LQI design.

    A: (n, n).  B: (n, m).  C: (k, n).  Returns (n + k, n + k) and (n + k, m).
    """
    k, n = np.shape(C)
    A_integral = np.block([[np.zeros((k, k)), np.asarray(C)], [np.zeros((n, k)), np.asarray(A)]])
    return A_integral, np.vstack([np.zeros((k, np.shape(B)[1])), B])


def _check_modes(A, B, concerned, what):
    """Hautus' test: every eigenvalue that `concerned` picks must be within reach of B."""
    scale = max(1.0, np.abs(A).max())
    for eigenvalue in np.linalg.eigvals(A):
        if concerned(eigenvalue):
            pencil = np.hstack([A - eigenvalue * np.eye(len(A)), B])
            if np.linalg.svd(pencil, compute_uv=False)[-1] <= _PIVOT * scale:
                raise ValueError(
                    "LQR has no solution: no %s the mode with eigenvalue %.4g%+.4gj; correct the model or the weights"
                    % (what, eigenvalue.real, eigenvalue.imag)
                )
