"""Who is coupled to whom, and walks over that: connected sets, rings around them, and narrow orders."""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

import numpy as np


class Graph(NamedTuple):
    """Who is coupled to whom: the neighbours of i are column[first[i] : first[i + 1]]."""

    first: np.ndarray
    column: np.ndarray


def starts(sorted_keys: np.ndarray, count: int) -> np.ndarray:
    """(count + 1,) where each key's entries start among sorted ones."""
    return np.searchsorted(sorted_keys, np.arange(count + 1)).astype(np.int64)


def symmetric(i: np.ndarray, j: np.ndarray, n: int) -> tuple[Graph, np.ndarray, np.ndarray]:
    """The graph of n that couples each i with its j, and the places of all (i, j) and all (j, i) in it."""
    ends, others = np.concatenate([i, j]).astype(np.int64), np.concatenate([j, i]).astype(np.int64)
    order = np.lexsort((others, ends))
    place = np.empty_like(order)
    place[order] = np.arange(len(order))
    return Graph(starts(ends[order], n), others[order]), place[: len(i)], place[len(i) :]


def connected(graph: Graph, inside: np.ndarray, most: int) -> list[np.ndarray]:
    """The vertices `inside` (n,) bool, split into connected sets of at most `most`.

    A set begins where the one before it broke off, so that the pieces of a long strip are shorter strips.
    """
    left, sets = inside.copy(), []
    ends: deque[int] = deque()
    for seed in np.flatnonzero(inside):
        ends.append(int(seed))
        while ends:
            begin = ends.popleft()
            if not left[begin]:
                continue
            ball = levels(graph, begin, left, most)
            sets.append(np.array(ball))
            left[ball] = False
            ends.extend(int(j) for i in ball for j in neighbours(graph, i) if left[j])
    return sets


def grown(graph: Graph, members: np.ndarray, inside: np.ndarray, rings: int) -> np.ndarray:
    """`members` and what lies within `rings` rings around them inside, ordered by levels from a far end."""
    within = np.zeros_like(inside)
    within[members] = True
    front = members
    for _ in range(rings):
        near = np.concatenate([neighbours(graph, i) for i in front] or [front])
        front = np.unique(near[inside[near] & ~within[near]])
        within[front] = True
    size = int(within.sum())
    far = levels(graph, int(members[0]), within, size)[-1]
    return np.array(levels(graph, far, within, size))


def levels(graph: Graph, begin: int, inside: np.ndarray, most: int) -> list[int]:
    """Up to `most` vertices inside, nearest to `begin` first; within a level, few neighbours first."""
    order, seen = [begin], {begin}
    for i in order:
        near = [j for j in neighbours(graph, i).tolist() if inside[j] and j not in seen]
        for j in sorted(near, key=lambda j: graph.first[j + 1] - graph.first[j]):
            if len(order) == most:
                return order
            seen.add(j)
            order.append(j)
    return order


def neighbours(graph: Graph, i: int) -> np.ndarray:
    """The vertices coupled to i."""
    return graph.column[graph.first[i] : graph.first[i + 1]]
