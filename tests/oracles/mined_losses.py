"""Losses over near and far images of a batch, pair by pair and triplet by triplet, of all or of those a miner picks."""

import math


def _similarity(one, other):
    lengths = math.hypot(*one) * math.hypot(*other)
    return sum(a * b for a, b in zip(one, other, strict=True)) / lengths


def _distance(one, other):
    one, other = ([value / math.hypot(*vector) for value in vector] for vector in (one, other))
    return math.dist(one, other)


UNLIKE = {  # the larger the less alike
    "cosine": lambda one, other: -_similarity(one, other),
    "euclidean": _distance,
    "squared": lambda one, other: _distance(one, other) ** 2,
}


def _others(places, i, near, far):
    apart = {j: math.dist(places[i], places[j]) for j in range(len(places)) if j != i}
    return [j for j in apart if apart[j] <= near], [j for j in apart if apart[j] > far]


def _triplets(descriptors, places, a, near, far, miner, distance, margin):
    """What is picked for one anchor, every positive with every negative."""
    unlike = {j: UNLIKE[distance](descriptors[a], descriptors[j]) for j in range(len(places)) if j != a}
    positives, negatives = _others(places, a, near, far)
    if miner is None or not positives or not negatives:
        return [(p, n) for p in positives for n in negatives]
    hardest, nearest = max(positives, key=unlike.get), min(negatives, key=unlike.get)
    if miner == "multi_similarity":
        keep = [p for p in positives if unlike[p] + 0.1 > unlike[nearest]]
        return [(p, n) for p in keep for n in negatives if unlike[n] - 0.1 < unlike[hardest]]
    if miner == "batch_hard":
        return [(hardest, nearest)]
    if miner == "batch_easy_hard":
        easiest = min(positives, key=unlike.get)
        beyond = [n for n in negatives if unlike[n] > unlike[easiest]]
        return [(easiest, min(beyond, key=unlike.get))] if beyond else []
    assert miner == "semihard"
    return [(p, n) for p in positives for n in negatives if 0 < unlike[n] - unlike[p] <= margin]


def _pairs(descriptors, places, a, near, far, miner, distance):
    """What is picked for one anchor, positives and negatives: without a miner also where there is only one kind."""
    if miner is None:
        return _others(places, a, near, far)
    found = _triplets(descriptors, places, a, near, far, miner, distance, None)
    return sorted({p for p, _ in found}), sorted({n for _, n in found})


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


def triplet(descriptors, places, near, far, margin, miner=None, distance="euclidean"):
    """Every anchor with every one of its positives and every one of its negatives."""
    return _mean_of_positive(triplet_costs(descriptors, places, near, far, margin, miner, distance))


def triplet_costs(descriptors, places, near, far, margin, miner=None, distance="euclidean"):
    costs, unlike = [], UNLIKE[distance]
    for a in range(len(places)):
        for p, n in _triplets(descriptors, places, a, near, far, miner, distance, margin):
            gap = unlike(descriptors[a], descriptors[p]) - unlike(descriptors[a], descriptors[n])
            costs.append(max(gap + margin, 0))
    return costs


def circle(descriptors, places, near, far, m, gamma, miner=None):
    """An anchor needs both kinds."""
    costs = []
    for a in range(len(places)):
        pull, push = _circle_terms(descriptors, places, a, near, far, m, gamma, miner)
        if pull and push:
            costs.append(math.log(1 + sum(pull.values()) * sum(push.values())))
    return _mean_of_positive(costs)


def _circle_terms(descriptors, places, a, near, far, m, gamma, miner):
    positives, negatives = _pairs(descriptors, places, a, near, far, miner, "cosine")
    low = {p: _similarity(descriptors[a], descriptors[p]) for p in positives}
    high = {n: _similarity(descriptors[a], descriptors[n]) for n in negatives}
    pull = {p: math.exp(-gamma * max(1 + m - s, 0) * (s - 1 + m)) for p, s in low.items()}
    push = {n: math.exp(gamma * max(s + m, 0) * (s - m)) for n, s in high.items()}
    return pull, push


def circle_slopes(descriptors, places, near, far, m, gamma, miner=None):
    """What each pair's similarity changes the cost by, over gamma."""
    slopes = []
    for a in range(len(places)):
        pull, push = _circle_terms(descriptors, places, a, near, far, m, gamma, miner)
        both = sum(pull.values()) * sum(push.values())
        for terms, reach in ((pull, lambda s: 1 + m - s), (push, lambda s: max(s + m, 0))):
            for j, term in terms.items():
                weight = reach(_similarity(descriptors[a], descriptors[j]))
                slopes.append(both / (1 + both) * term / sum(terms.values()) * weight)
    return slopes


def multi_similarity(descriptors, places, near, far, alpha, beta, base, miner=None, distance="cosine"):
    """Each kind adds its own part."""
    costs = []
    for a in range(len(places)):
        pull, push = _similarity_terms(descriptors, places, a, near, far, alpha, beta, base, miner, distance)
        costs.append(math.log(1 + sum(pull)) / alpha + math.log(1 + sum(push)) / beta)
    return sum(costs) / len(costs)


def _similarity_terms(descriptors, places, a, near, far, alpha, beta, base, miner, distance):
    positives, negatives = _pairs(descriptors, places, a, near, far, miner, distance)
    unlike, base = UNLIKE[distance], -base if distance == "cosine" else base
    pull = [math.exp(alpha * (unlike(descriptors[a], descriptors[p]) - base)) for p in positives]
    push = [math.exp(beta * (base - unlike(descriptors[a], descriptors[n]))) for n in negatives]
    return pull, push


def multi_similarity_slopes(descriptors, places, near, far, alpha, beta, base, miner=None, distance="cosine"):
    """What each pair's similarity changes the cost by."""
    slopes = []
    for a in range(len(places)):
        for terms in _similarity_terms(descriptors, places, a, near, far, alpha, beta, base, miner, distance):
            slopes.extend(term / (1 + sum(terms)) for term in terms)
    return slopes
