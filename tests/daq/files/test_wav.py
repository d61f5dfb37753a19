"""WAV files of every sample format, as programs and recorders write them."""

import struct
from pathlib import Path

import numpy as np
import pytest
from scipy.io import wavfile

from daq.files.wav import is_wav, open_wav
from daq.setup.errors import InputError


@pytest.mark.parametrize("kind", ["int16", "int32", "uint8", "float32"])
def test_sample_formats_read_alike(tmp_path: Path, kind: str) -> None:
    """8, 16, 32 bit and float WAV give the same sound."""
    wave = 0.5 * np.sin(np.arange(8000) / 9.0)
    stored = {
        "int16": (wave * 32767).astype(np.int16),
        "int32": (wave * 2147483647).astype(np.int32),
        "uint8": (wave * 127 + 128).astype(np.uint8),
        "float32": wave.astype(np.float32),
    }[kind]
    wavfile.write(tmp_path / "x.wav", 8000, stored)
    wav = open_wav(tmp_path / "x.wav")
    samples = wav.read()
    assert wav.rate_hz == 8000.0
    assert np.corrcoef(samples[:, 0], wave)[0, 1] > 0.999


@pytest.mark.parametrize("size", ["whole", "streamed"])
def test_24_bit_wav_of_a_recorder(tmp_path: Path, size: str) -> None:
    """24 bit, an extensible header, a chunk in front, and sizes never filled in: what recorders write."""
    codes = (0.5 * np.sin(np.arange(8000) / 9.0) * 8388607).astype("<i4")
    data = codes.view(np.uint8).reshape(-1, 4)[:, :3].tobytes()
    kind = struct.pack("<HHIIHHHHI", 0xFFFE, 1, 48000, 144000, 3, 24, 22, 24, 4)
    kind += bytes.fromhex("0100000000001000800000aa00389b71")
    length = len(data) if size == "whole" else 0xFFFFFFFF
    body = b"WAVELIST" + struct.pack("<I", 4) + b"INFOfmt " + struct.pack("<I", len(kind)) + kind
    body += b"data" + struct.pack("<I", length) + data
    total = len(body) if size == "whole" else 0xFFFFFFFF
    (tmp_path / "r.wav").write_bytes(b"RIFF" + struct.pack("<I", total) + body)
    wav = open_wav(tmp_path / "r.wav")
    samples = wav.read()
    assert wav.rate_hz == 48000.0 and samples.shape == (8000, 1)
    assert samples[:, 0] == pytest.approx(codes / 8388608.0)
    np.testing.assert_array_equal(wav.codes(10, 20)[:, 0], codes[10:20] << 8)


def test_a_damaged_wav_is_an_error(tmp_path: Path) -> None:
    """A WAV header without a WAV behind it is refused by name."""
    target = tmp_path / "bad.wav"
    target.write_bytes(b"RIFF\x10\x00\x00\x00WAVEjunkjunkjunk")
    with pytest.raises(InputError, match=r"bad\.wav"):
        open_wav(target)


def test_a_big_endian_wav(tmp_path: Path) -> None:
    """RIFX files have every number the other way round, and read the same."""
    codes = np.arange(-400, 400, dtype=">i2").reshape(-1, 2)
    head = b"fmt " + struct.pack(">IHHIIHH", 16, 1, 2, 8000, 32000, 4, 16) + b"data" + struct.pack(">I", codes.nbytes)
    target = tmp_path / "big.wav"
    target.write_bytes(b"RIFX" + struct.pack(">I", 4 + len(head) + codes.nbytes) + b"WAVE" + head + codes.tobytes())
    wav = open_wav(target)
    assert is_wav(target) and (wav.rate_hz, wav.channels, wav.n_samples) == (8000.0, 2, 400)
    np.testing.assert_array_equal(wav.codes(), codes)
    assert wav.read(5, 7) == pytest.approx(codes[5:7] / 32768.0)
