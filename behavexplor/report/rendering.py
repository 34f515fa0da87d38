"""Rendering of templates with this package's styles and scripts into self-contained HTML pages."""

import base64
import hashlib
from collections.abc import Sequence
from importlib.metadata import version
from importlib.resources import files
from typing import Any, Final

from jinja2 import BaseLoader, Environment, StrictUndefined

import behavexplor

_LIBRARIES: Final = ("gymnasium", "highway-env", "numpy", "scikit-learn")


def rendered(template: str, scripts: Sequence[str], **values: object) -> str:
    """Render a page in ASCII. All values are escaped, so none is interpreted as HTML.

    Template and scripts are files of this package. The scripts run at the end of the page, in their order.
    """
    style, script = source("page.css"), "".join(map(source, scripts))
    text = filled(
        template,
        escapes=True,
        **values,
        style=style,
        script=script,
        policy=f"default-src 'none'; style-src '{_hash(style)}'; script-src '{_hash(script)}'; img-src data:; "
        "base-uri 'none'; form-action 'none'",
        versions={"behavexplor": behavexplor.__version__, **{name: version(name) for name in _LIBRARIES}},
    )
    return text.encode("ascii", "xmlcharrefreplace").decode("ascii")


def filled(template: str, *, escapes: bool, **values: object) -> str:
    """Return a template of this package with values in it; `escapes` says whether they are escaped for HTML."""
    options: dict[str, Any] = {"undefined": StrictUndefined, "trim_blocks": True, "lstrip_blocks": True}
    environment = Environment(loader=_Sources(), autoescape=escapes, **options)  # noqa: S701 - Markdown is not escaped
    return environment.get_template(template).render(**values)


class _Sources(BaseLoader):
    """Loader of the templates beside this module, also from a zipped package."""

    def get_source(self, environment: Environment, template: str) -> tuple[str, str | None, Any]:  # noqa: ARG002
        return source(template), None, None


def source(name: str) -> str:
    """Return the text of a file of this package."""
    return files("behavexplor.report").joinpath(name).read_text("utf-8")


def _hash(text: str) -> str:
    """Return the hash of a script or a style sheet for a content security policy."""
    return "sha256-" + base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
