"""What happens when a frame comes: place it, form a node if it is time, evaluate again, merge."""

from __future__ import annotations

from analytic.descriptors.base import Description, Descriptor
from analytic.mapper.closure import point_of
from analytic.mapper.creation import first_node, grow_version_1, grow_version_2, join_parked
from analytic.mapper.decision import Decision, Reason
from analytic.mapper.merging import Known, merge_alike
from analytic.mapper.node import Mode, Node
from analytic.mapper.placing import Placement, place
from analytic.mapper.reconsidering import join, reconsider
from analytic.mapper.state import NONE, State


def step(state: State, descriptor: Descriptor, description: Description, orientation: bool) -> Decision:
    """Work a frame into a state and return what became of it.

    Args:
        state: a copy of the map, which is changed.
        descriptor: of the map.
        description: of the frame.
        orientation: whether orientation parts are compared.
    """
    placement = place(state, descriptor, description, orientation) if state.nodes else Placement(Reason.FIRST_FRAMES)
    frame = state.append(description, NONE, placement.match)
    if placement.node != NONE:
        join(state, frame, description, placement.node, placement.mode)
        state.pending = ()
    created = _grow(state, placement, frame, description)
    if created is not None and state.rules.version == 2 and len(state.nodes) > 1:
        reconsider(state, descriptor, created.id, orientation)
    changed = placement.node if created is None else created.id
    wanted = {"changed": changed != NONE, "created": created is not None}
    if wanted.get(state.rules.merge, False):
        # What is known of the frame's distances holds for nodes that are as they were when it was placed.
        known = Known(point_of(description), placement.closures) if created is None and placement.closures else None
        merge_alike(state, changed, known)
    label = int(state.labels[frame])
    return Decision(
        None if label == NONE else label,
        _reason(state, placement.reason, frame),
        placement.scores,
        frame,
        state.changes,
    )


def maintain(state: State, node: int, descriptions: list[Description]) -> Decision:
    """Give a node another mode: frames of another appearance of its place. The modes that it has stay as they are."""
    start = len(state.labels)
    for description in descriptions:
        state.append(description, node, NONE)
    frames = range(start, len(state.labels))
    mode = Mode.of(state.rules, frames, descriptions)
    known = state.nodes[node]
    state.nodes[node] = Node(node, (*known.modes, mode))
    state.pending = ()
    state.note(Reason.MAINTAINED, node, frames)
    return Decision(node, Reason.MAINTAINED, {"modes": len(known.modes) + 1}, frames[-1], state.changes)


def _grow(state: State, placement: Placement, frame: int, description: Description) -> Node | None:
    """Form a node if it is time; note in the placement if the frame went to a parked candidate."""
    if placement.reason is Reason.FIRST_FRAMES:
        state.pending = (*state.pending, frame)
        return first_node(state)
    if state.rules.version == 2:
        return grow_version_2(state)
    if placement.node != NONE:
        return None
    joined = join_parked(state, frame, description)
    if joined is None:
        state.pending = (*state.pending, frame)
        return grow_version_1(state)
    state.pending = ()
    placement.reason = Reason.JOINED_PARKED
    placement.scores["parked"], created = joined
    return created


def _reason(state: State, placed: Reason, frame: int) -> Reason:
    """Return why a frame is where it is: the last change that moved it, but a merging only if it made a node vanish."""
    reason = placed
    for change in state.changes:
        if frame in change.frames and change.reason is not Reason.PARKED_FORGOTTEN:
            reason = change.reason
    return reason
