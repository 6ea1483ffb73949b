"""Figures with the settings of this package, whatever those of the user are."""

from contextlib import contextmanager
from io import BytesIO
import warnings

from matplotlib import rcParams, style
from matplotlib.figure import Figure


@contextmanager
def own_settings():
    """Draw as Matplotlib does by default, but in the user's fonts, which may have more scripts."""
    fonts = {name: rcParams[name] for name in ('font.family', 'font.sans-serif', 'font.serif')}
    with style.context(['default', fonts]):
        yield


class Picture(Figure):
    """A Figure that notebooks show without pyplot."""

    @own_settings()
    def savefig(self, *arguments, **options):
        with warnings.catch_warnings():
            # Names may be in scripts that the font lacks; boxes stand for their letters.
            warnings.filterwarnings('ignore', message='Glyph .* missing')
            super().savefig(*arguments, **options)

    def _repr_png_(self):
        with BytesIO() as file:
            self.savefig(file, format='png')
            return file.getvalue()
