"""The forward algorithm as loops over frames."""

from __future__ import annotations

import math


def transitions(positions, step: float, spacing: float) -> list[list[float]]:
    variance = step**2 + spacing**2 / 6
    table = []
    for a in positions:
        row = [
            math.exp(-(math.dist(a, b) ** 2) / (2 * variance)) if math.dist(a, b) <= 4 * math.sqrt(variance) else 0.0
            for b in positions
        ]
        table.append([weight / math.fsum(row) for weight in row])
    return table


def forward(distances, table, temperature: float, kidnapping: float) -> list[list[float]]:
    """Return the belief after each query of one sequence."""
    m = len(table)
    belief, beliefs = [1 / m] * m, []
    for query in distances:
        moved = [math.fsum(belief[i] * table[i][j] for i in range(m)) for j in range(m)]
        expected = [(1 - kidnapping) * moved[j] + kidnapping / m for j in range(m)]
        # Shifting all distances alike leaves the softmax and keeps it in the range of numbers.
        raw = [expected[j] * math.exp((min(query) - query[j]) / temperature) for j in range(m)]
        belief = [value / math.fsum(raw) for value in raw]
        beliefs.append(belief)
    return beliefs
