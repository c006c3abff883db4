"""What a user must know of a history that has come to its end."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from ngepc.discretisation.finer import unresolved_data
from ngepc.discretisation.gap_records import nearer_between_nodes
from ngepc.discretisation.sampled import what_is_unseen
from ngepc.evolution.memory import Memory
from ngepc.evolution.result import EvolutionStep
from ngepc.model.data import order_note
from ngepc.model.round import round_note
from ngepc.results.fields import Fields, frobenius
from ngepc.results.remarks import (
    SMALL_ROTATION,
    SMALL_STRAIN,
    at_plastic_points,
    few_facets,
    large_motion,
    large_part,
    like_a_coefficient,
    turning,
)


def remarks(steps: Sequence[EvolutionStep], memory: Memory) -> str:
    """Contact that never happens or is on few facets, data from samples, strains not small.

    Strains are those of the step with the largest displacement, facets of the largest force;
    ``memory`` is the history after the last step.
    """
    if not steps:
        return ""
    found = []
    problem = steps[-1].fields.problem
    if problem.contact is not None and not any(s.record.contact_force for s in steps):
        found.append("Nothing touches the obstacle in any step.")
    pressed = max((s.record for s in steps), key=lambda record: record.contact_force)
    few = few_facets(pressed.contact_facets, pressed.contact_nodes)
    smooth = like_a_coefficient(problem, pressed.max_contact_pressure)
    resolved = partial(unresolved_data, points=memory.functions.points)
    notes = (order_note, round_note, what_is_unseen, resolved, nearer_between_nodes)
    at_times = {pressed.time: [few, smooth]}
    maximum = problem.processes.maximum
    sizes = [
        maximum(np.abs(s.values_of("displacement")).max(initial=0.0)) for s in steps
    ]
    largest = steps[int(np.argmax(sizes))]
    strain, rotation = strain_and_rotation(largest.fields)
    if strain > SMALL_STRAIN or rotation > SMALL_ROTATION:
        said = large_motion(strain, rotation, large_part(largest.fields))
        at_times.setdefault(largest.record.time, []).append(said)
    for time, sentences in at_times.items():
        if any(sentences):
            found.append(" ".join([f"At time {time:g}:", *filter(None, sentences)]))
    found += filter(None, (note(problem) for note in notes))
    return " ".join(found)


def strain_and_rotation(fields: Fields) -> tuple[float, float]:
    """The largest |eps(u)| and rotation (rad) at the points of plasticity."""
    problem = fields.problem
    size = at_plastic_points(problem, frobenius(fields.strain))
    strain = problem.processes.maximum(size)
    return strain, turning(problem, fields.displacement)
