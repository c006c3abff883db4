"""For lectures and exercises: a look at results, answers and quizzes that check themselves."""

from __future__ import annotations

import html
import json
import sys
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from matplotlib.figure import Figure
from ngsolve import CoefficientFunction

from ngepc.checks.kinds import require_function
from ngepc.pictures import views
from ngepc.pictures.fields import plot_comparison, plot_field
from ngepc.pictures.scenes import ViewOptions

QUIZZES = Path(__file__).parents[1] / "notebooks" / "quizzes.json"
STYLE = (
    "<style>.quiz span{display:none;margin-left:1.7em}.quiz :checked~span{display:block}"
    ".quiz label{margin-left:.5em}.quiz p{margin:.9em 0 .2em}</style>"
)


def look(
    source: object,
    field: str | CoefficientFunction = "equivalent_plastic_strain",
    options: ViewOptions | None = None,
    title: str = "",
    name: str = "",
) -> views.View | Figure:
    """What ``views.show`` shows; without the viewer a still picture, of |u| for the pressure."""
    if views.viewer_installed():
        return views.show(source, field, options, title, name)
    still = plot_comparison if isinstance(source, Mapping) else plot_field
    field = "displacement" if isinstance(field, str) and field == "contact_pressure" else field
    drawn = options or ViewOptions()
    return still(source, field, deformation_scale=drawn.deformation_scale, units=drawn.units)


class Answers:
    """Says of each answer of an exercise whether it is right; called with a question and a test.

    Attributes
    ----------
    done
        Question -> whether its answer was right.
    errors
        Question -> what its test raised: an answer that is not there yet may do anything.
    """

    def __init__(self) -> None:
        self.done: dict[str, bool] = {}
        self.errors: dict[str, Exception] = {}

    def __call__(self, question: str, test: Callable[[], object]) -> None:
        """Write 'right', 'not yet' or 'fill in' and the question; ``test`` takes nothing."""
        require_function("test", test, "nothing")
        self.errors.pop(question, None)
        try:
            self.done[question] = bool(test())
            word = "right:  " if self.done[question] else "not yet:"
        except Exception as error:  # an answer that is not there yet may raise anything
            self.done[question], self.errors[question], word = False, error, "fill in:"
        sys.stdout.write(f"{word} {question}\n")


@dataclass(frozen=True)
class Quiz:
    """Questions at the end of a lecture; a click on a choice says whether it is right, and why.

    Plain HTML, which works in notebooks and on pages without network.

    Parameters
    ----------
    questions
        Each with 'text', 'choices' (the first is right, they are shown in alphabetical order) and
        'why', which is said with the right one.
    """

    questions: tuple[dict, ...]

    def _repr_html_(self) -> str:
        return f'{STYLE}<div class="quiz">{"".join(map(_form, self.questions))}</div>'


def quiz(lecture: str) -> Quiz:
    """The quiz of a lecture, such as '01_first_solve', from ``notebooks/quizzes.json``."""
    quizzes = json.loads(QUIZZES.read_text(encoding="utf-8"))
    if lecture not in quizzes:
        raise ValueError(f"lecture={lecture!r}: one of {', '.join(quizzes)} is needed")
    return Quiz(tuple(quizzes[lecture]))


def _form(question: dict) -> str:
    """A question as HTML."""
    lines = [f"<p>{html.escape(question['text'])}</p>"]
    group = f"quiz-{zlib.crc32(question['text'].encode())}"
    for number, choice in enumerate(sorted(question["choices"])):
        right = choice == question["choices"][0]
        said = f"Right. {question['why']}" if right else "No. Try another."
        lines.append(
            f'<div><input type="radio" name="{group}" id="{group}-{number}">'
            f'<label for="{group}-{number}">{html.escape(choice)}</label>'
            f"<span>{html.escape(said)}</span></div>"
        )
    return "".join(lines)
