"""Modified bending springs: q is the signed distance δ of the line x1x2 from the line x3x4.

The spring of the course notes between the shared edge of a hinge and the line through its opposite vertices.
With u = x2 − x1, v = x4 − x3 and n = (v × u)/|v × u|, δ = (x3 − x1)·n. The feet of the common normal are x1 +
α1 u and x3 + α2 v, and the weights (−(1 − α1), −α1, 1 − α2, α2) along n are the exact gradient, because
the distance is stationary in both feet. δ goes smoothly through zero where the hinge is flat.

Over the heights h1 and h2 of the two triangles, δ = h1 h2 sin θ / ℓ with ℓ² = h1² + h2² + 2 h1 h2 cos θ. That
grows up to the fold limit cos θ_max = −min(h)/max(h) and falls beyond, down to parallel lines without any
distance; a spring would let go of a hinge that folds farther. So a little before the limit, at θ_s, the angle
takes over: q = δ(θ_s) + δ'(θ_s) φ + ½ δ'(0) φ², φ = |θ| − θ_s, which joins with value and slope and grows on
as far as the hinge may turn.
"""

import math

from sim.compiled import Vec3, add, cross, dot, inner, kernel, norm, put_corner, scale, sub
from sim.springs.angle import dihedral, dihedral_gradient, hinge_at

PARALLEL = 1e-6
"""sin² of the angle between the lines below which their common normal is not worth computing."""

REACH, SHARPNESS = 0.9, 8
"""The lines are used to cos θ_s = −REACH · smooth minimum (h1/h2, h2/h1), a mean of power −SHARPNESS."""


@kernel
def coordinate(positions, nodes, memory, q, gradient, new_memory):
    """Fill q = δ [m], continued by the angle past θ_s, and its gradient; the memory is n, θ and q."""
    for e in range(len(nodes)):
        hinge = hinge_at(positions, nodes, e)
        before = Vec3(memory[e, 0], memory[e, 1], memory[e, 2])
        theta = memory[e, 3] if hinge.thin else dihedral(hinge, memory[e, 3])
        normal = before
        if not hinge.thin and past_lines(hinge, theta):
            q[e] = _by_angle(hinge, theta, gradient, e)
        elif hinge.thin and abs(theta) > math.pi / 2.0:
            q[e] = memory[e, 4]
            gradient[e] = 0.0
        else:
            a1, a2, normal, q[e] = feet(hinge, before)
            put_corner(gradient, e, 0, scale(a1 - 1.0, normal))
            put_corner(gradient, e, 1, scale(-a1, normal))
            put_corner(gradient, e, 2, scale(1.0 - a2, normal))
            put_corner(gradient, e, 3, scale(a2, normal))
        for r in range(3):
            new_memory[e, r] = normal[r]
        new_memory[e, 3] = theta
        new_memory[e, 4] = q[e]


@inner
def feet(hinge, before):
    """α1, α2, n and δ of the two lines; midpoints where they are parallel, with the direction `before`."""
    u, v = hinge.edge, sub(hinge.to4, hinge.to3)
    a, b, c = dot(u, u), dot(u, v), dot(v, v)
    across = cross(v, u)
    square = dot(across, across)
    if square > PARALLEL * a * c:
        a1 = a2 = 0.0
        for _ in range(2):  # once more, so that lines almost parallel lose no digits
            w = sub(scale(a1, u), add(hinge.to3, scale(a2, v)))
            d1, d2 = (b * dot(v, w) - c * dot(u, w)) / square, (a * dot(v, w) - b * dot(u, w)) / square
            a1, a2 = a1 + d1, a2 + d2
        n = scale(1.0 / math.sqrt(square), across)
        return a1, a2, n, dot(hinge.to3, n)
    a2 = 0.5
    a1 = 0.5 * (dot(hinge.to3, u) + dot(hinge.to4, u)) / a if a > 0.0 else 0.5
    rise = sub(add(hinge.to3, scale(a2, v)), scale(a1, u))
    distance = norm(rise)
    if distance > 0.0:
        n = scale((-1.0 if dot(rise, before) < 0.0 else 1.0) / distance, rise)
        return a1, a2, n, dot(rise, n)
    return a1, a2, before, 0.0


@inner
def past_lines(hinge, theta):
    """Whether the hinge is folded beyond θ_s."""
    if abs(theta) <= math.pi / 2.0:
        return False
    return abs(theta) > math.pi or math.cos(theta) < -_limit(hinge)


@inner
def _limit(hinge):
    """−cos θ_s, smooth in both heights and below min(h1/h2, h2/h1)."""
    ratio = math.sqrt(dot(hinge.n1, hinge.n1) / dot(hinge.n2, hinge.n2))
    return REACH * (ratio**SHARPNESS + ratio**-SHARPNESS) ** (-1.0 / SHARPNESS)


@inner
def _by_angle(hinge, theta, gradient, e):
    """Q beyond θ_s, and its gradient ∂q/∂θ ∇θ + ∂q/∂h1 ∇h1 + ∂q/∂h2 ∇h2."""
    sign = -1.0 if theta < 0.0 else 1.0
    h1, h2 = norm(hinge.n1) / hinge.length, norm(hinge.n2) / hinge.length
    cosine = -_limit(hinge)
    sine = math.sqrt(1.0 - cosine * cosine)
    square = h1 * h1 + h2 * h2 + 2.0 * h1 * h2 * cosine
    distance = h1 * h2 * sine / math.sqrt(square)
    slope = h1 * h2 * (h1 + cosine * h2) * (h2 + cosine * h1) / square**1.5
    growth = h1 * h2 / (h1 + h2)
    past = abs(theta) - math.acos(cosine)
    d1 = _by_height(h1, h2, cosine, sine, square, slope, growth, past)
    d2 = _by_height(h2, h1, cosine, sine, square, slope, growth, past)
    turn = slope + growth * past
    g1, g2, g3, g4 = dihedral_gradient(hinge)
    t3 = dot(hinge.to3, hinge.edge) / (hinge.length * hinge.length)
    t4 = dot(hinge.to4, hinge.edge) / (hinge.length * hinge.length)
    m3 = scale(sign * d1 / h1, sub(hinge.to3, scale(t3, hinge.edge)))
    m4 = scale(sign * d2 / h2, sub(hinge.to4, scale(t4, hinge.edge)))
    put_corner(gradient, e, 0, add(scale(turn, g1), add(scale(t3 - 1.0, m3), scale(t4 - 1.0, m4))))
    put_corner(gradient, e, 1, add(scale(turn, g2), add(scale(-t3, m3), scale(-t4, m4))))
    put_corner(gradient, e, 2, add(scale(turn, g3), m3))
    put_corner(gradient, e, 3, add(scale(turn, g4), m4))
    return sign * (distance + slope * past + 0.5 * growth * past * past)


@inner
def _by_height(h, other, cosine, sine, square, slope, growth, past):
    """∂q/∂h at fixed θ, where cos θ_s and with it all else changes with h."""
    ratio = h / other
    weight = 2.0 / (1.0 + ratio ** (-2 * SHARPNESS))
    d_cosine = cosine * (1.0 - weight) / h
    d_limit = -d_cosine / sine
    d_square = 2.0 * (h + other * cosine + h * other * d_cosine)
    d_slope = slope * (
        1.0 / h
        + (1.0 + d_cosine * other) / (h + cosine * other)
        + (cosine + d_cosine * h) / (other + cosine * h)
        - 1.5 * d_square / square
    )
    d_distance = sine * other * other * (other + cosine * h) / square**1.5
    d_growth = (growth / h) ** 2
    return d_distance + (d_slope - growth * d_limit) * past + 0.5 * d_growth * past * past


@kernel
def curvature(positions, nodes, memory, out):
    """Fill ∇²δ; beyond θ_s and for parallel lines it is left out."""
    for e in range(len(nodes)):
        hinge = hinge_at(positions, nodes, e)
        out[e] = 0.0
        u, v = hinge.edge, sub(hinge.to4, hinge.to3)
        a, b, c = dot(u, u), dot(u, v), dot(v, v)
        square = a * c - b * b
        if square <= PARALLEL * a * c:
            continue
        if past_lines(hinge, memory[e, 3] if hinge.thin else dihedral(hinge, memory[e, 3])):
            continue
        a1, a2, n, distance = feet(hinge, hinge.edge)
        u_star = scale(1.0 / square, sub(scale(c, u), scale(b, v)))
        v_star = scale(1.0 / square, sub(scale(a, v), scale(b, u)))
        for j in range(4):
            weight = a1 - 1.0 if j == 0 else (-a1 if j == 1 else (1.0 - a2 if j == 2 else a2))
            du = -1.0 if j == 0 else (1.0 if j == 1 else 0.0)
            dv = -1.0 if j == 2 else (1.0 if j == 3 else 0.0)
            for s in range(3):
                d1 = u_star[s] * weight + distance * n[s] * (c * du - b * dv) / square
                d2 = -v_star[s] * weight + distance * n[s] * (b * du - a * dv) / square
                for r in range(3):
                    dn = -n[s] * (u_star[r] * du + v_star[r] * dv)
                    out[e, r, 3 * j + s] = (a1 - 1.0) * dn + n[r] * d1
                    out[e, 3 + r, 3 * j + s] = -a1 * dn - n[r] * d1
                    out[e, 6 + r, 3 * j + s] = (1.0 - a2) * dn - n[r] * d2
                    out[e, 9 + r, 3 * j + s] = a2 * dn + n[r] * d2
