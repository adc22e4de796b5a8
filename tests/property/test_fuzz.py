"""A million bytes from a fixed seed, and every input that once did harm, through the fuzz target."""

import random
from pathlib import Path

import fuzz_target
import pytest
from signed_frames import OTHER_KEY, Signer, heartbeat, of_unknown_id

REGRESSIONS = sorted((Path(__file__).resolve().parents[1] / "fuzz" / "regressions").iterdir())
MAGIC = (b"\xfd", b"\xfe", b"\xfd\x09\x01\x00")


def test_a_million_random_bytes_with_frames_begun_among_them():
    rng, fuzzed = random.Random(2), 0
    while fuzzed < 1_000_000:
        data = bytearray(rng.randbytes(rng.randrange(1, 400)))
        for _ in range(rng.randrange(4)):
            at = rng.randrange(len(data))
            data[at:at] = rng.choice(MAGIC)
        fuzz_target.run(bytes(data))
        fuzzed += len(data)


def test_damaged_forged_and_unknown_frames():
    rng = random.Random(3)
    for _ in range(3000):
        frames = b""
        for _ in range(rng.randrange(1, 4)):
            forger = Signer(rng.randrange(256), compid=rng.randrange(256), key=rng.choice((None, OTHER_KEY)))
            frame = forger.pack(heartbeat())
            frames += rng.choice((frame, of_unknown_id(frame, None), of_unknown_id(frame, OTHER_KEY)))
        data = bytearray(frames)
        for _ in range(rng.randrange(3)):
            data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
        fuzz_target.run(b"\0" + bytes(data))


@pytest.mark.parametrize("stamp", [0, 1, 2**48 - 1, 2**47, 37_992_960_000_000, 37_992_960_000_000 - 6_000_001])
def test_any_payload_of_one_who_has_the_key(stamp):
    rng = random.Random(stamp)
    for _ in range(500):
        kind = bytes([rng.randrange(128, 256)])
        fuzz_target.run(kind + stamp.to_bytes(6, "little") + rng.randbytes(rng.randrange(260)))


@pytest.mark.parametrize("path", REGRESSIONS, ids=lambda path: path.name)
def test_inputs_that_once_did_harm(path):
    fuzz_target.run(path.read_bytes())
