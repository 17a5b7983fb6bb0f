"""Linear-quadratic regulators, checked (thesis 7.3: "infinite-horizon LQR").

All gains follow u = +K (x_reference - x), i.e. A - B K is stable (errata 6 and 7: the thesis prints a minus sign).
"""

import numpy as np
from scipy.linalg import LinAlgError, solve_continuous_are, solve_discrete_are

_SYMMETRY = 1e-9
_PIVOT = 1e-9  # a mode counts as out of reach when [lambda I - A, B] is this close to losing rank


def lqr_gain(A, B, Q, R):
    """Gain (m, n) that minimises the integral of x'Qx + u'Ru subject to x' = A x + B u.

    A: (n, n).  B: (n, m).  Q: (n, n) or its diagonal (n,), positive semidefinite.  R: (m, m) or its diagonal (m,),
    positive definite.  Raises ValueError that says which of them is wrong, or which mode no input reaches.
    """
    A, B, Q, R = _checked(A, B, Q, R)
    _check_modes(A, B, lambda eigenvalue: eigenvalue.real >= -_PIVOT, "input reaches")
    _check_modes(A.T, _square_root(Q), lambda eigenvalue: abs(eigenvalue.real) <= _PIVOT, "weight in Q sees")
    return np.linalg.solve(R, B.T @ _solve(solve_continuous_are, A, B, Q, R))


def dlqr_gain(A, B, Q, R):
    """Gain (m, n) that minimises the sum of x'Qx + u'Ru subject to x[k+1] = A x[k] + B u[k]; else as `lqr_gain`."""
    A, B, Q, R = _checked(A, B, Q, R)
    _check_modes(A, B, lambda eigenvalue: abs(eigenvalue) >= 1.0 - _PIVOT, "input reaches")
    _check_modes(A.T, _square_root(Q), lambda eigenvalue: abs(abs(eigenvalue) - 1.0) <= _PIVOT, "weight in Q sees")
    P = _solve(solve_discrete_are, A, B, Q, R)
    return np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A)


def with_integral(A, B, C):
    """(A, B) of the plant with the integrals of y = C x as its first states: the plant of an LQI design.

    A: (n, n).  B: (n, m).  C: (k, n).  Returns (n + k, n + k) and (n + k, m).
    """
    A, B, C = np.atleast_2d(A), np.atleast_2d(B), np.atleast_2d(C)
    k, n = C.shape
    if A.shape != (n, n) or B.shape[0] != n:
        raise ValueError("A %s, B %s and C %s do not fit together" % (A.shape, B.shape, C.shape))
    A_integral = np.block([[np.zeros((k, k)), C], [np.zeros((n, k)), A]])
    return A_integral, np.vstack([np.zeros((k, B.shape[1])), B])


def _checked(A, B, Q, R):
    A, B = np.array(A, dtype=float, ndmin=2), np.array(B, dtype=float, ndmin=2)
    Q, R = (np.diag(weight) if np.ndim(weight) == 1 else np.array(weight, dtype=float, ndmin=2) for weight in (Q, R))
    n, m = B.shape
    if A.shape != (n, n) or Q.shape != (n, n) or R.shape != (m, m):
        raise ValueError(
            "LQR needs A (n, n), B (n, m), Q (n, n), R (m, m); got %s, %s, %s, %s"
            % (A.shape, B.shape, Q.shape, R.shape)
        )
    for name, matrix in (("A", A), ("B", B), ("Q", Q), ("R", R)):
        if not np.all(np.isfinite(matrix)):
            raise ValueError("LQR: %s has an entry that is not a finite number" % name)
    for name, matrix in (("Q", Q), ("R", R)):
        if np.abs(matrix - matrix.T).max() > _SYMMETRY * max(1.0, np.abs(matrix).max()):
            raise ValueError("LQR: %s is not symmetric" % name)
    if np.linalg.eigvalsh(Q).min() < -_SYMMETRY * max(1.0, np.abs(Q).max()):
        raise ValueError("LQR: Q has a negative eigenvalue: weights must be 0 or more")
    if np.linalg.eigvalsh(R).min() <= 0.0:
        raise ValueError("LQR: R must be positive: a free input would be infinite")
    return A, B, Q, R


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


def _square_root(Q):
    values, vectors = np.linalg.eigh(Q)
    return vectors * np.sqrt(np.clip(values, 0.0, None))


def _solve(solver, A, B, Q, R):
    try:
        return solver(A, B, Q, R)
    except LinAlgError as error:
        raise ValueError(
            "LQR has no solution for these weights (%s): they differ by too many decades" % error
        ) from error
