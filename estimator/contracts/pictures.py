"""Coded pictures: what a decoder gives to the driver that received them. The driver knows the wire, the decoder the code."""

from enum import Enum
from typing import Protocol

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray


class PictureRefusal(Enum):
    """Reason for the refusal of an image; the value is the name of its counter."""

    TOO_SHORT = "too_short"
    """The data are shorter than a header."""
    BAD_MAGIC = "bad_magic"
    """The data do not begin as a picture does."""
    BAD_SIZE = "bad_size"
    """The picture is of a size that is not decoded."""
    INTER_PICTURE = "inter_picture"
    """The picture is coded as the change of an earlier one, which this format's pictures are not."""
    TORN = "torn"
    """The data end before the picture does."""
    BAD_CODE = "bad_code"
    """The picture holds a code that its format does not have."""


class CodedPicture(Struct, frozen=True):
    """The header of a picture that can be decoded."""

    width: int
    """Width, px: a multiple of 16."""
    height: int
    quantizer: int
    """The coarseness of the picture's coefficients, 1 to 30; 31 stands for 2."""
    number: int
    """The sender's count of pictures, modulo 2**32."""


class PictureDecoder(Protocol):
    """Decodes pictures of one format, each by itself."""

    def header(self, data: bytes) -> CodedPicture | PictureRefusal:
        """Read what picture the data hold. Never raises."""
        ...

    def decode(self, data: bytes, picture: CodedPicture) -> NDArray[np.uint8] | PictureRefusal:
        """Return a whole picture's pixels, (height, width, 3) BGR; `picture` is its header. Never raises."""
        ...
