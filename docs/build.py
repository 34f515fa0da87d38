"""Makes the environments' pages from their docstrings: python docs/build.py [--pictures]."""

import inspect
import sys
from pathlib import Path

import gymnasium
from PIL import Image

import behavexplor

FOLDER = Path(__file__).parent / "environments"
SEED = 4  # of the scenario in the pictures
VIEWS = {"intersection": (900, 900, 4.4, [0.5, 0.88]), "lane": (1500, 260, 5.6, [0.05, 0.5])}  # size, scale, centre


def page(name: str) -> str:
    """The page of an environment: what is special to it, then what all share."""
    env = type(gymnasium.make(f"{behavexplor.NAMESPACE}/{name}-v0").unwrapped)
    special, version = (inspect.cleandoc(env.__doc__ or "") + "\n").split("## Version history")
    shared = (
        inspect.cleandoc(env.__mro__[1].__doc__ or "").partition("## Concrete scenarios")[2].partition("Raises:")[0]
    )
    text = f"# {behavexplor.NAMESPACE}/{name}-v0\n\n{special}## Concrete scenarios{shared}## Version history{version}"
    return "<!-- made from the docstrings by docs/build.py -->\n\n" + text.strip() + "\n"


def picture(name: str) -> Image.Image:
    """A sampled scenario at its start, the NPCs' routes drawn."""
    width, height, scaling, centre = VIEWS[name.partition("-")[0]]
    config = {"screen_width": width, "screen_height": height, "scaling": scaling, "centering_position": centre}
    env = gymnasium.make(f"{behavexplor.NAMESPACE}/{name}-v0", config=config, render_mode="rgb_array")
    env.reset(seed=SEED)
    image = Image.fromarray(env.render())
    env.close()
    return image


def main() -> None:
    """Write all pages, and the pictures if asked to."""
    for name in behavexplor.FUNCTIONAL_SCENARIOS:
        (FOLDER / f"{name}.md").write_text(page(name))
        if "--pictures" in sys.argv[1:]:
            picture(name).save(FOLDER / f"{name}.png", optimize=True)


if __name__ == "__main__":
    main()
