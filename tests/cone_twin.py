"""What the bounds of normals rest on, in plain float64: nets of tangents and of the normal patch, angles, equation 14."""

import math

import numpy as np


def net_product(along_u, along_v, multiply):
    """Bernstein coefficients (n, 6, 6, ...) of the product of nets (n, 3, 4, ...) and (n, 4, 3, ...), an average each."""
    out = 0.0
    for i, k in np.ndindex(3, 4):
        for j, m in np.ndindex(4, 3):
            weight = math.comb(2, i) * math.comb(3, k) * math.comb(3, j) * math.comb(2, m)
            term = weight * multiply(along_u[:, i, k], along_v[:, j, m])
            if np.ndim(out) == 0:
                out = np.zeros((len(term), 6, 6, *term.shape[1:]))
            out[:, i + j, k + m] += term / (math.comb(5, i + j) * math.comb(5, k + m))
    return out


def dots(net, axis):
    """Of the vectors (n, rows, columns, 3) of nets with unit vectors (n, 3): (n, rows * columns)."""
    return np.einsum("nijc,nc->nij", net, axis).reshape(len(net), -1)


def half_angle(net, axis):
    """Of the cone about unit vectors (n, 3) that holds the vectors of a net; zero vectors are in any."""
    vectors = net.reshape(len(net), -1, 3)
    across = np.linalg.norm(np.cross(vectors, axis[:, None]), axis=2)
    return np.arctan2(across, dots(net, axis)).max(axis=1)


def combine(alpha_t, alpha_b, beta):
    """Half angle of the normals' cone (NaN where there is none), and sin(beta - alpha_t - alpha_b). beta up to 90 degrees."""
    apart = np.sin(beta - alpha_t - alpha_b)
    squares = np.sin(alpha_t) ** 2 + 2 * np.sin(alpha_t) * np.sin(alpha_b) * np.cos(beta) + np.sin(alpha_b) ** 2
    sine = np.sqrt(squares) / np.sin(beta)
    valid = (alpha_t + alpha_b < beta) & (sine < 1)
    return np.where(valid, np.arcsin(np.minimum(sine, 1)), np.nan), apart


def widened(angle, error):
    """angle + asin(error); infinite from 90 degrees on, or where one is NaN."""
    with np.errstate(invalid="ignore"):
        wider = angle + np.arcsin(np.where((error >= 0) & (error < 1), error, np.nan))
    return np.where(wider < np.pi / 2, wider, np.inf)
