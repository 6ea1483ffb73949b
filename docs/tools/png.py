"""PNG files of the pages: small, and with the text of the run that drew them."""

from os import PathLike

from PIL import Image
from PIL.PngImagePlugin import PngInfo


def save_png(picture: str | PathLike[str], path: str | PathLike[str], description: str) -> None:
    """Write a PNG file again, with at most 256 colours and a description."""
    content = PngInfo()
    content.add_itxt('Description', description)
    with Image.open(picture) as image:
        # The median cut loses colours of small marks, and dither grains plain areas.
        image.convert('RGB').quantize(
            256, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE).save(
                path, pnginfo=content, optimize=True)
