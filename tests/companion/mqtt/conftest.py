from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support.certificates import make_certificates
from tests.support.mosquitto import Broker, need_mosquitto


@pytest.fixture(scope="session")
def certificates(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("certificates")
    make_certificates(folder)
    return folder


@pytest.fixture
def broker(tmp_path: Path, certificates: Path) -> Iterator[Broker]:
    """Running; gone afterwards."""
    need_mosquitto()
    folder = tmp_path / "broker"
    folder.mkdir()
    broker = Broker(folder, certificates)
    broker.write_files()
    broker.start()
    yield broker
    broker.go_on()
    broker.stop()
