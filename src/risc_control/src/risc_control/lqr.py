"""Linear-quadratic regulators, checked (thesis 7.3: "infinite-horizon LQR").

All gains follow u = +K (x_reference - x), i.e. A - B K is stable (errata 6 and 7: the thesis prints a minus sign).
"""

import numpy as np
from scipy.linalg import LinAlgError, solve_continuous_are

_PIVOT = 1e-9  # a mode counts as uncontrollable when [lambda I - A, B] is this close to losing rank


def lqr_gain(A, B, Q, R):
    """Gain (m, n) that minimises the integral of x'Qx + u'Ru subject to x' = A x + B u.

    A: (n, n).  B: (n, m).  Q: (n, n) or its diagonal (n,), positive semidefinite.  R: (m, m) or its diagonal (m,),
    positive definite.  Raises ValueError that says which of them is wrong, or which mode is not controllable.
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


def lqi_gain(A, B, q_integral, Q, R):
    """As `lqr_gain` with the integral of the first state, of weight q_integral, before the states; (m, 1 + n).

    Q: a diagonal (n,).  With q_integral = 0 there is no integral: its gain is 0.
    """
    A, B = np.asarray(A, dtype=float), np.asarray(B, dtype=float)
    if q_integral == 0.0:
        return np.insert(lqr_gain(A, B, Q, R), 0, 0.0, axis=1)
    with_integral = np.block([[np.zeros((1, 1)), np.eye(1, len(A))], [np.zeros((len(A), 1)), A]])
    return lqr_gain(with_integral, np.vstack([np.zeros((1, B.shape[1])), B]), [q_integral, *Q], R)


def _check_modes(A, B, concerned, what):
    """Hautus test: every mode whose eigenvalue `concerned` selects must be controllable from B."""
    scale = max(1.0, np.abs(A).max())
    for eigenvalue in np.linalg.eigvals(A):
        if concerned(eigenvalue):
            pencil = np.hstack([A - eigenvalue * np.eye(len(A)), B])
            if np.linalg.svd(pencil, compute_uv=False)[-1] <= _PIVOT * scale:
                raise ValueError(
                    "LQR has no solution: no %s the mode with eigenvalue %.4g%+.4gj; correct the model or the weights"
                    % (what, eigenvalue.real, eigenvalue.imag)
                )
