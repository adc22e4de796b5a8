"""A signing key is read from a private file, in three forms, or refused in words."""

import hashlib
import os

import pytest

from gcs_coloc.config.sections import SigningConfig
from gcs_coloc.core.errors import ConfigError
from gcs_coloc.links.signed_links import SignedLinks, read_key

RAW = bytes(range(100, 132))


def written(tmp_path, content, mode=0o600):
    path = tmp_path / "the.key"
    path.write_bytes(content)
    path.chmod(mode)
    return path


@pytest.mark.parametrize(
    ("content", "key"),
    [
        (RAW, RAW),
        (RAW.hex().encode(), RAW),
        (RAW.hex().upper().encode() + b"\r\n", RAW),
        (b"correct horse battery staple\n", hashlib.sha256(b"correct horse battery staple").digest()),
        ("schöne Grüße".encode(), hashlib.sha256("schöne Grüße".encode()).digest()),
        (b"a passphrase of 32 bytes in all!", hashlib.sha256(b"a passphrase of 32 bytes in all!").digest()),
        (b"a passphrase, line end: 32 bytes\n"[-32:], hashlib.sha256(b" passphrase, line end: 32 bytes"[-31:]).digest()),
    ],
)
def test_the_forms_of_a_key(tmp_path, content, key):
    assert read_key(written(tmp_path, content)) == key


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "holds no signing key"),
        (b"\n", "holds no signing key"),
        (RAW[:-1], "64 hexadecimal digits"),
        (RAW + b"\xff", "holds no signing key"),
        (b"two\nlines\n", "holds no signing key"),
        (bytes(32), "openssl rand -hex 32"),
        (b"00" * 32, "openssl rand -hex 32"),
        (b"\xfe" * 100_000, "holds no signing key"),
    ],
)
def test_what_is_no_key(tmp_path, content, words):
    with pytest.raises(ConfigError, match=words):
        read_key(written(tmp_path, content))


@pytest.mark.parametrize("mode", [0o644, 0o640, 0o604, 0o602, 0o660])
def test_a_key_that_others_can_use_is_refused_with_the_remedy(tmp_path, mode):
    path = written(tmp_path, RAW, mode)
    with pytest.raises(ConfigError, match=f"mode {mode:04o}.*chmod 600 {path}"):
        read_key(path)
    path.chmod(0o400)
    assert read_key(path) == RAW


def test_what_is_no_file(tmp_path):
    with pytest.raises(ConfigError, match="cannot be read: No such file"):
        read_key(tmp_path / "absent.key")
    os.mkfifo(tmp_path / "pipe", 0o600)
    with pytest.raises(ConfigError, match="pipe: is no file"):
        read_key(tmp_path / "pipe")


def test_each_link_has_its_mode_and_number(tmp_path):
    links = ("14550", "serial:/dev/ttyUSB0:57600", "tcp:10.0.0.1:5760")
    config = SigningConfig(
        key_file=str(written(tmp_path, RAW)), mode="require", links={"/dev/ttyUSB0": "accept", "tcp:10.0.0.1:5760": "off"}
    )
    signed = SignedLinks(config, links)
    first, second = signed.of("udpin:0.0.0.0:14550"), signed.of("serial:/dev/ttyUSB0:57600")
    assert first is not None
    assert second is not None
    assert (first.required, second.required) == (True, False)
    assert first.link_id != second.link_id
    assert first.signing is second.signing
    assert signed.of("tcp:10.0.0.1:5760") is None


def test_without_a_key_no_link_is_signed():
    assert SignedLinks(SigningConfig(), ("14550",)).of("udpin:0.0.0.0:14550") is None


def test_the_mode_of_a_link_that_there_is_not_is_an_error(tmp_path):
    config = SigningConfig(key_file=str(written(tmp_path, RAW)), links={"14551": "require"})
    with pytest.raises(ConfigError, match=r"14551 is none of the links: udpin:0\.0\.0\.0:14550"):
        SignedLinks(config, ("14550",))


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"mode": "require"}, "no key_file is set"),
        ({"links": {"14550": "accept"}}, "no key_file is set"),
        ({"key_file": "the.key"}, 'set mode = "require"'),
        ({"key_file": "the.key", "mode": "always"}, "'require', 'accept' or 'off'"),
    ],
)
def test_a_key_and_its_use_must_agree(settings, words):
    with pytest.raises(ValueError, match=words):
        SigningConfig(**settings)
