"""Impact zones: the least impulses that keep every target, at once."""

import numpy as np
import pytest
from scipy.optimize import nnls

from sim.contact.contacts import make_contacts
from sim.contact.response import push_apart
from sim.contact.zones import MOST_IN_ZONE, MOST_PASSES, settle_zones

H = 0.01


def cluster(seed, count, vertices):
    """Contacts of random kinds between random vertices, and where these are."""
    rng = np.random.default_rng(seed)
    contacts = make_contacts(count)
    contacts.key[:] = np.arange(count)
    for c in range(count):
        contacts.node[c] = rng.choice(vertices, 4, replace=False)
        s, t = rng.uniform(0.1, 0.9, 2)
        contacts.weight[c] = [1, -s * t, -s * (1 - t), s - 1] if c % 2 else [1 - s, s, t - 1, -t]
    n = rng.standard_normal((count, 3))
    contacts.normal[:] = n / np.linalg.norm(n, axis=1)[:, None]
    contacts.thickness[:] = 1e-3
    return contacts, rng.uniform(0.1, 2.0, vertices), 0.01 * rng.standard_normal((vertices, 3)), rng


def settled(contacts, targets, masses, x, v, sweeps=True):
    """Positions, velocities, impulses and counts after sweeps and zones."""
    x, v, inverse, given = x.copy(), v.copy(), 1.0 / masses, np.zeros(len(targets))
    about = contacts, targets, contacts.masses(inverse), inverse, H, x, v, given
    if sweeps:
        push_apart(*about)
    hopeless = np.zeros(len(x), dtype=np.int64)
    counts = [settle_zones(*about, hopeless) for _ in range(MOST_PASSES)]
    return x, v, given, (sum(settled for settled, _ in counts), counts[-1][1])


def least_change(contacts, targets, masses, x):
    """Where the least change, weighed with masses, keeps all targets.

    That is least distance programming, done with non-negative least squares (Lawson and Hanson 1974, ch. 23).
    """
    rows = np.zeros((len(targets), *x.shape))
    for c in range(len(targets)):
        for i, w in zip(contacts.node[c], contacts.weight[c], strict=True):
            rows[c, i] += w * contacts.normal[c]
    scaled = (rows / np.sqrt(masses)[:, None]).reshape(len(targets), -1)
    lack = targets - contacts.gaps(x)
    u = nnls(np.vstack([scaled.T, lack]), np.append(np.zeros(scaled.shape[1]), 1.0), maxiter=10_000)[0]
    r = np.append(scaled.T @ u, lack @ u - 1.0)
    return x - (r[:-1] / r[-1]).reshape(x.shape) / np.sqrt(masses)[:, None]


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("sweeps", [False, True])
def test_a_zone_takes_the_least_change_that_keeps_all_targets(seed, sweeps):
    contacts, masses, x, _ = cluster(seed, 12, 16)
    targets = np.full(12, 1e-3)
    found, v, given, (zones, left) = settled(contacts, targets, masses, x, np.zeros_like(x), sweeps)
    assert zones >= 1 or sweeps  # which may have got there
    assert left == 0
    assert (given >= 0.0).all()
    size = np.abs(x).max()
    np.testing.assert_allclose(found, least_change(contacts, targets, masses, x), atol=1e-7 * size)
    assert (contacts.gaps(found) - targets).min() > -1e-10 * size
    np.testing.assert_allclose(found - x, H * v, atol=1e-12 * size)
    assert np.abs(masses @ v).max() < 1e-12 * (masses @ np.abs(v)).max()


def row_of_balls(count, masses):
    """Vertices in a row, each in contact with the next."""
    contacts = make_contacts(count - 1)
    contacts.key[:] = np.arange(count - 1)
    contacts.node[:, 0], contacts.node[:, 1:] = np.arange(1, count), np.arange(count - 1)[:, None]
    contacts.weight[:, 0], contacts.weight[:, 1] = 1.0, -1.0
    contacts.normal[:, 0], contacts.thickness[:] = 1.0, 1e-3
    x, v = np.zeros((count, 3)), np.zeros((count, 3))
    x[:, 0] = 1e-3 * np.arange(count)
    return contacts, x, v


@pytest.mark.parametrize("ratio", [1.0, 1e4])
def test_a_row_that_is_hit_at_its_end_goes_on_as_one(ratio):
    """Sweeps hand such a push on from one to the next, and are far from done in twenty."""
    count, masses = 20, np.geomspace(1.0, ratio, 20)
    contacts, x, v = row_of_balls(count, masses)
    v[0, 0] = 1.0
    end, targets = x + H * v, np.full(count - 1, 1e-3)
    swept, w = end.copy(), v.copy()
    mu = contacts.masses(1.0 / masses)
    assert push_apart(contacts, targets, mu, 1.0 / masses, H, swept, w, np.zeros(count - 1)) > 0
    assert np.abs(w[:, 0] - w[0, 0]).max() > 1e-3
    _, w, _, (zones, _) = settled(contacts, targets, masses, end, v)
    assert zones > 0
    np.testing.assert_allclose(w[:, 0], masses[0] / masses.sum(), rtol=1e-6)


def test_contacts_that_say_the_same_twice_share_the_impulse():
    contacts, masses, x, _ = cluster(3, 10, 12)
    twice = contacts.only(np.tile(np.arange(10), 2))
    once, double = (
        settled(c, np.full(len(c.key), 1e-3), masses, x, np.zeros_like(x), False) for c in (contacts, twice)
    )
    assert once[3][1] == double[3][1] == 0
    np.testing.assert_allclose(double[0], once[0], atol=1e-8)


def test_a_zone_without_a_way_out_or_too_large_is_left_as_it_is():
    contacts, x, v = row_of_balls(3, np.ones(3))
    against = contacts.only(np.tile(np.arange(2), 2))
    against.normal[2:] *= -1.0  # both ways at once, farther than there is room
    masses, targets, x = np.ones(3), np.full(4, 1e-3), np.zeros_like(x)
    found, _, given, counts = settled(against, targets, masses, x, v, False)
    assert counts == (0, 1)
    assert np.array_equal(found, x)
    assert not given.any()
    long, x, v = row_of_balls(MOST_IN_ZONE + 2, np.ones(1))
    masses = np.ones(MOST_IN_ZONE + 2)
    assert settled(long, np.full(len(long.key), 2e-3), masses, x, v, False)[3] == (0, 1)
