"""Losses over near and far images of a batch, pair by pair and triplet by triplet."""

import math


def _similarity(one, other):
    lengths = math.hypot(*one) * math.hypot(*other)
    return sum(a * b for a, b in zip(one, other, strict=True)) / lengths


def _distance(one, other):
    one, other = ([value / math.hypot(*vector) for value in vector] for vector in (one, other))
    return math.dist(one, other)


def _others(places, i, near, far):
    apart = {j: math.dist(places[i], places[j]) for j in range(len(places)) if j != i}
    return [j for j in apart if apart[j] <= near], [j for j in apart if apart[j] > far]


def _mean_of_positive(costs):
    costs = [cost for cost in costs if cost > 0]
    return sum(costs) / max(len(costs), 1)


def metric_calibrated(descriptors, places, cap):
    """Every pair once."""
    pairs = [(i, j) for i in range(len(places)) for j in range(i)]
    costs = [
        (math.dist(descriptors[i], descriptors[j]) - math.sqrt(2) * min(math.dist(places[i], places[j]) / cap, 1)) ** 2
        for i, j in pairs
    ]
    return sum(costs) / max(len(costs), 1)


def triplet(descriptors, places, near, far, margin):
    """Every anchor with every one of its positives and every one of its negatives."""
    return _mean_of_positive(triplet_costs(descriptors, places, near, far, margin))


def triplet_costs(descriptors, places, near, far, margin):
    costs = []
    for a in range(len(places)):
        positives, negatives = _others(places, a, near, far)
        for p in positives:
            for n in negatives:
                gap = _distance(descriptors[a], descriptors[p]) - _distance(descriptors[a], descriptors[n])
                costs.append(max(gap + margin, 0))
    return costs


def circle(descriptors, places, near, far, m, gamma):
    """An anchor needs both kinds."""
    costs = []
    for a in range(len(places)):
        positives, negatives = _others(places, a, near, far)
        if not positives or not negatives:
            continue
        low = [_similarity(descriptors[a], descriptors[p]) for p in positives]
        high = [_similarity(descriptors[a], descriptors[n]) for n in negatives]
        pull = sum(math.exp(-gamma * max(1 + m - s, 0) * (s - 1 + m)) for s in low)
        push = sum(math.exp(gamma * max(s + m, 0) * (s - m)) for s in high)
        costs.append(math.log(1 + pull * push))
    return _mean_of_positive(costs)


def multi_similarity(descriptors, places, near, far, alpha, beta, base):
    """Each kind adds its own part."""
    costs = []
    for a in range(len(places)):
        positives, negatives = _others(places, a, near, far)
        pull = sum(math.exp(-alpha * (_similarity(descriptors[a], descriptors[p]) - base)) for p in positives)
        push = sum(math.exp(beta * (_similarity(descriptors[a], descriptors[n]) - base)) for n in negatives)
        costs.append(math.log(1 + pull) / alpha + math.log(1 + push) / beta)
    return sum(costs) / len(costs)
