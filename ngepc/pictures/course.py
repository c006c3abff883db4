"""For lectures and exercises: views of results, and answers and quizzes that are checked."""

import html
import json
import re
import sys
from collections.abc import Callable
from pathlib import Path

from matplotlib.figure import Figure

from ngepc.checks.kinds import require_function
from ngepc.pictures import views
from ngepc.pictures.fields import plot_field

QUIZZES = Path(__file__).parents[1] / "notebooks" / "quizzes.json"


def look(
    source: object, *field: object, name: str = "", **drawn: object
) -> views.View | Figure:
    """The view of ``views.show``; without the viewer a still picture without a slider."""
    if views.viewer_installed():
        return views.show(source, *field, name=name, **drawn)
    return plot_field(source, *field, **drawn)


class Answers:
    """Check the answers of an exercise; called with a question and a test.

    ``done`` has whether the answer of a question was right, ``errors`` what its test raised.
    """

    def __init__(self) -> None:
        self.done: dict[str, bool] = {}
        self.errors: dict[str, Exception] = {}

    def __call__(self, question: str, test: Callable[[], object]) -> None:
        """Write 'right', 'not yet' or 'fill in' and the question; ``test`` takes nothing.

        Behind 'fill in' stands the message of the error: an answer is missing, or it has a mistake.
        """
        require_function("test", test, "nothing")
        self.errors.pop(question, None)
        try:
            self.done[question] = bool(test())
            line = f"{'right:  ' if self.done[question] else 'not yet:'} {question}"
        except Exception as error:  # unfinished answers may raise any exception
            self.done[question], self.errors[question] = False, error
            line = f"fill in: {question} ({error})"
        sys.stdout.write(line + "\n")


class Quiz(tuple):
    """Questions at the end of a lecture; a click on a choice shows whether it is right, and why.

    Each has a 'text', 'choices' (the first is right, they are shown in alphabetical order) and
    'why', the explanation that is shown with the right choice.
    """

    def _repr_html_(self) -> str:
        parts = []
        for question in self:
            right = question["choices"][0]
            text = _marked_up(question["text"])
            parts.append(f"<p style='margin-top: 1em'>{text}</p>")
            for choice in sorted(question["choices"]):
                reply = "No. Try another."
                if choice == right:
                    reply = f"Right. {question['why']}"
                summary = f"<summary>{_marked_up(choice)}</summary>"
                parts.append(f"<details>{summary}{_marked_up(reply)}</details>")
        return "".join(parts)


def _marked_up(text: str) -> str:
    """A text of a quiz in HTML; what follows a Greek letter and an underscore is a subscript."""
    return re.sub(r"(?<=[α-ω])_(\w+)", r"<sub>\1</sub>", html.escape(text))


def quiz(lecture: str) -> Quiz:
    """The quiz of a lecture, such as '01_first_solve', from ``notebooks/quizzes.json``."""
    quizzes = json.loads(QUIZZES.read_text(encoding="utf-8"))
    if lecture not in quizzes:
        raise ValueError(f"lecture={lecture!r}: one of {', '.join(quizzes)} is needed")
    return Quiz(quizzes[lecture])
