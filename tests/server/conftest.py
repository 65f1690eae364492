"""A lab with simulations that need no kernels, a clock, and a browser."""

import pytest
from fake_world import SCENE, FakeWorld, RawClient, nothing_to_compile, wait_until

from server.lab import Lab
from tests.browser import launched


class Wall:
    """A wall clock that only tests move."""

    now = 100.0

    def __call__(self):
        return self.now


@pytest.fixture
def wall():
    return Wall()


@pytest.fixture
def lab():
    FakeWorld.made.clear()
    lab = Lab(SCENE, port=0, build=FakeWorld, prepare=nothing_to_compile)
    lab.start()
    wait_until(lambda: len(FakeWorld.made) == 2)
    yield lab
    for world in FakeWorld.made:
        world.gate.set()
    lab.stop()


@pytest.fixture
def client(lab):
    client = RawClient(lab.url, origin=lab.url)
    client.look()
    yield client
    client.close()


@pytest.fixture(scope="module")
def browser():
    with launched() as browser:
        yield browser
