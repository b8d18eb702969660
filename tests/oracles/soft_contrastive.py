"""The soft contrastive loss, term by term."""

import math


def soft_contrastive_loss(descriptors, places, buildings, temperature, sigma, kernel="gaussian"):
    """Mean over the images with a neighbour of -sum_j p_ij log q_ij, as its docstring writes it."""
    count, costs = len(descriptors), []
    for i in range(count):
        others = [j for j in range(count) if j != i]
        near = {}
        for j in others:
            apart = math.dist(places[i], places[j]) if buildings[i] == buildings[j] else math.inf
            near[j] = math.exp(-apart / sigma) if kernel == "exponential" else math.exp(-(apart**2) / (2 * sigma**2))
        weight = sum(near.values())
        if weight <= 1e-6:
            continue
        alike = {
            j: math.exp(sum(a * b for a, b in zip(descriptors[i], descriptors[j], strict=True)) / temperature)
            for j in others
        }
        whole = sum(alike.values())
        costs.append(-sum(near[j] / weight * math.log(alike[j] / whole) for j in others))
    return sum(costs) / max(len(costs), 1)
