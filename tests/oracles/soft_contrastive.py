"""The soft contrastive loss, term by term."""

import math


def soft_contrastive_loss(
    descriptors, places, buildings, temperature, sigma, kernel="gaussian", rooms=None, room_share=0.0, overlap=None
):
    """Mean over the images with a neighbour or a room mate of -sum_j p_ij log q_ij, as its docstring writes it."""
    count, costs = len(descriptors), []
    for i in range(count):
        others = [j for j in range(count) if j != i]
        near = {}
        for j in others:
            apart = math.dist(places[i], places[j]) if buildings[i] == buildings[j] else math.inf
            near[j] = math.exp(-apart / sigma) if kernel == "exponential" else math.exp(-(apart**2) / (2 * sigma**2))
            if kernel == "overlap":
                near[j] = overlap[i][j] ** (1 / sigma)
            walled = rooms is not None and room_share > 0 and rooms[i] >= 0 and rooms[j] >= 0 and rooms[i] != rooms[j]
            if math.isnan(near[j]) or walled:
                near[j] = 0.0
        mates = {j: float(rooms is not None and rooms[i] >= 0 and rooms[i] == rooms[j]) for j in others}
        known = [j for j in others if rooms is None or rooms[j] >= 0]
        parts = []
        for share, weights, among in ((1 - room_share, near, others), (room_share, mates, known)):
            total = sum(weights.values())
            if share > 0 and total > 1e-6:
                parts.append((share, {j: weights[j] / total for j in among}))
        weight = sum(share for share, _ in parts)
        if weight == 0:
            continue
        alike = {
            j: math.exp(sum(a * b for a, b in zip(descriptors[i], descriptors[j], strict=True)) / temperature)
            for j in others
        }
        cost = 0.0
        for share, wanted in parts:
            whole = sum(alike[j] for j in wanted)
            cost -= share / weight * sum(wanted[j] * math.log(alike[j] / whole) for j in wanted)
        costs.append(cost)
    return sum(costs) / max(len(costs), 1)
