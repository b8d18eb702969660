"""The incremental mapper, with everything recomputed from all frames of a node whenever it is needed.

Only maps of one mode per node. Covariances are scikit-learn's, inverses are numpy's, prominence is a walk.
"""

from __future__ import annotations

from functools import cache
from itertools import pairwise

import numpy as np
from sklearn.covariance import ledoit_wolf


class SlowMapper:
    """Frames as (position, orientation) arrays in; labels out."""

    def __init__(self, version=1, omega=1.85, y=1.5, gamma=5.0, two_sided=True, merge="changed"):
        self.version, self.omega, self.y, self.gamma = version, omega, y, gamma
        self.two_sided, self.merge = two_sided, merge
        self.frames = []  # (position, orientation or None)
        self.labels = []
        self.nodes = {}  # id -> list of (frame, held out?)
        self.parked = []  # (id, list of (frame, held out?))
        self.pending = []
        self.next_id = 0

    # --- statistics of a node

    def positions(self, frames):
        return np.array([self.frames[f][0] for f in frames], dtype=np.float64)

    def centre(self, members):
        return self.positions([f for f, _ in members]).mean(axis=0)

    def closure(self, point, members):
        model = self.positions([f for f, held in members if not held])
        held = self.positions([f for f, held in members if held])
        inverse = self.inverse(tuple(f for f, held in members if not held))

        def delta(x):
            return float((x - model.mean(axis=0)) @ inverse @ (x - model.mean(axis=0)))

        distances = [delta(x) for x in held]
        apart = delta(point) - np.mean(distances)
        deviation = abs(apart) if self.two_sided else max(apart, 0)
        return deviation, np.std(distances, ddof=1)

    @staticmethod
    def ratio(deviation, std):
        return deviation / std if std else 0.0

    @cache  # noqa: B019 - the frames of a mapper never change, and it lives as long as its test
    def inverse(self, frames):
        return np.linalg.inv(ledoit_wolf(self.positions(frames))[0])

    def x(self):
        return max(self.omega, 3.05 - 0.15 * len(self.nodes))

    @staticmethod
    def with_frame(members, frame):
        held = sum(h for _, h in members) < int(0.2 * (len(members) + 1) + 1e-9)
        return [*members, (frame, held)]

    def members_of(self, frames):
        members = []
        for frame in frames:
            members = self.with_frame(members, frame)
        return members

    # --- image level

    def similarities(self, query, nodes, leave_out=None):
        compared = [(f, n) for n in sorted(nodes) for f, _ in self.nodes[n] if f != leave_out]
        position = [self._euclidean(query[0], self.frames[f][0]) for f, _ in compared]
        total = self._share(position)
        if query[1] is not None:
            total = total * self._share([self._aligned(query[1], self.frames[f][1]) for f, _ in compared])
        return compared, total

    @staticmethod
    def _euclidean(a, b):
        return float(np.sqrt(((a.astype(np.float64) - b) ** 2).sum()))

    @staticmethod
    def _aligned(a, b):
        turns = [((a.astype(np.float64) - np.roll(b, s, axis=0)) ** 2).sum() for s in range(len(b))]
        return float(np.sqrt(min(turns)))

    @staticmethod
    def _share(distances):
        inverse = np.array([1 / max(d, 1e-6 * max(distances)) for d in distances])
        return inverse / inverse.sum()

    def means(self, compared, similarity):
        return {
            n: float(np.mean([s for (_, m), s in zip(compared, similarity, strict=True) if m == n]))
            for n in {n for _, n in compared}
        }

    # --- conditions

    def prominent(self, compared, similarity, candidates):
        value = {f: s for (f, _), s in zip(compared, similarity, strict=True)}
        curve = [0.0, *(value.get(f, 0.0) for f in range(len(self.labels))), 0.0]
        heights = {f: walk(curve, f + 1) for f in value}
        best = min(value, key=lambda f: (-value[f], f))
        return heights[best] >= self.gamma * sum(heights.values()) / len(value)

    def keeps_centroid(self, point, members):
        points = self.positions([f for f, _ in members])
        moved = np.linalg.norm(points.mean(axis=0) - np.vstack([points, point]).mean(axis=0))
        without = [
            np.linalg.norm(np.delete(points, j, axis=0).mean(axis=0) - points.mean(axis=0)) for j in range(len(points))
        ]
        return moved <= max(without)

    def distinct(self, centre, nodes):
        centres = [self.centre(nodes[n]) for n in sorted(nodes)]
        away = np.mean([np.linalg.norm(centre - c) for c in centres])
        among = [np.linalg.norm(a - b) for i, a in enumerate(centres) for b in centres[i + 1 :]]
        return away >= (np.mean(among) if among else 0)

    # --- a frame comes

    def add(self, position, orientation=None):
        query = (np.asarray(position), None if orientation is None else np.asarray(orientation))
        goal = self.place(query) if self.nodes else None
        frame = len(self.labels)
        self.frames.append(query)
        self.labels.append(-1 if goal is None else goal)
        created = None
        if not self.nodes:
            self.pending.append(frame)
            if len(self.pending) == 20:
                created = self.create(self.members_of(self.pending))
        elif goal is not None:
            self.nodes[goal] = self.with_frame(self.nodes[goal], frame)
            self.pending = []
            created = self.grow_2() if self.version == 2 else None
        elif self.version == 1:
            created = self.grow_1(frame)
        else:
            created = self.grow_2()
        if created is not None and self.version == 2 and len(self.nodes) > 1:
            self.reconsider(created)
        changed = created if created is not None else goal
        if changed is not None and (self.merge == "changed" or (self.merge == "created" and created is not None)):
            self.merge_alike(changed)
        return self.labels[frame]

    def place(self, query):
        point = query[0].astype(np.float64)
        candidates = []
        for n in sorted(self.nodes):
            deviation, std = self.closure(point, self.nodes[n])
            if deviation <= self.x() * std:
                candidates.append(n)
        if not candidates:
            return None
        compared, similarity = self.similarities(query, candidates)
        if self.version == 1:
            best = max(range(len(compared)), key=lambda i: (similarity[i], -compared[i][0]))
            goal = compared[best][1]
            if not self.prominent(compared, similarity, candidates):
                return None
        else:
            means = self.means(compared, similarity)
            goal = min(means, key=lambda n: (-means[n], n))
        return goal if self.keeps_centroid(point, self.nodes[goal]) else None

    def create(self, members, node=None):
        if node is None:
            node, self.next_id = self.next_id, self.next_id + 1
        self.nodes[node] = members
        for frame, _ in members:
            self.labels[frame] = node
        self.pending = []
        return node

    def grow_1(self, frame):
        point = self.positions([frame])[0]
        ratios = []
        for i, (node, members) in enumerate(self.parked):
            deviation, std = self.closure(point, members)
            if deviation <= self.x() * std:
                ratios.append((self.ratio(deviation, std), node, i))
        if ratios:
            _, node, i = min(ratios)
            self.pending = []
            self.parked[i] = (node, self.with_frame(self.parked[i][1], frame))
            if self.distinct(self.centre(self.parked[i][1]), self.nodes):
                return self.create(self.parked.pop(i)[1], node)
            return None
        self.pending.append(frame)
        if len(self.pending) < 15:
            return None
        members = self.members_of(self.pending)
        if self.distinct(self.centre(members), self.nodes):
            return self.create(members)
        self.parked = [*self.parked, (self.next_id, members)][-8:]
        self.next_id += 1
        self.pending = []
        return None

    def grow_2(self):
        count = len(self.labels)
        unassigned = [f for f in range(max(0, count - 30), count) if self.labels[f] == -1]
        if len(unassigned) >= 28:
            return self.create(self.members_of(unassigned))
        last = range(max(0, count - 20), count)
        unassigned = [f for f in last if self.labels[f] == -1]
        if len(unassigned) >= 15:
            return self.create_if_distinct(unassigned)
        nodes = [self.labels[f] for f in last if self.labels[f] != -1]
        if sum(a != b for a, b in pairwise(nodes)) >= 9:
            return self.create_if_distinct(list(last))
        return None

    def create_if_distinct(self, frames):
        nodes, labels = self.leave(frames)
        taken = [f for f in frames if labels[f] == -1]
        if len(taken) < 10 or not self.distinct(self.positions(taken).mean(axis=0), nodes):
            return None
        self.nodes, self.labels = nodes, labels
        return self.create(self.members_of(taken))

    def leave(self, frames):
        nodes, labels = dict(self.nodes), list(self.labels)
        for n in self.nodes:
            leaving = [f for f in frames if self.labels[f] == n]
            left = [(f, held) for f, held in nodes[n] if f not in leaving]
            if not leaving or len(left) < 10:
                continue
            held = sum(h for _, h in left)
            nodes[n] = self.members_of([f for f, _ in left]) if min(held, len(left) - held) < 2 else left
            for frame in leaving:
                labels[frame] = -1
        return nodes, labels

    def reconsider(self, created):
        first = min(f for f, _ in self.nodes[created]) - 40
        start = max(first, len(self.labels) - 70, 0)
        goals = {f: self.better(f, created) for f in range(start, len(self.labels))}
        moving = [f for f in goals if goals[f] != self.labels[f]]
        origin = {f: self.labels[f] for f in moving}
        self.nodes, self.labels = self.leave([f for f in moving if origin[f] != -1])
        for frame in sorted(moving, key=lambda f: (origin[f], goals[f], f)):
            if self.labels[frame] == -1:
                self.labels[frame] = goals[frame]
                self.nodes[goals[frame]] = self.with_frame(self.nodes[goals[frame]], frame)

    def better(self, frame, created):
        own = self.labels[frame]
        point = self.positions([frame])[0]
        options = set(self.nodes) if own == -1 else {own, created}
        for n in self.nodes if own == created else []:
            deviation, std = self.closure(point, self.nodes[n])
            if deviation <= self.x() * std and self.keeps_centroid(point, self.nodes[n]):
                options.add(n)
        if len(options) < 2:
            return next(iter(options))
        means = self.means(*self.similarities(self.frames[frame], options, leave_out=frame))
        return min(means, key=lambda n: (-means[n], n != own, n))

    def merge_alike(self, node):
        while True:
            centre = self.centre(self.nodes[node])
            alike = []
            for other in self.nodes:
                if other != node:
                    deviation, std = self.closure(centre, self.nodes[other])
                    if deviation <= self.y * std:
                        alike.append((self.ratio(deviation, std), other))
            if not alike:
                return
            other = min(alike)[1]
            kept, gone = min(node, other), max(node, other)
            self.nodes[kept] = [*self.nodes[kept], *self.nodes.pop(gone)]
            self.labels = [kept if label == gone else label for label in self.labels]
            node = kept


def walk(curve, peak):
    """Prominence of one sample of a curve, by walking down from it; of a flat peak the first sample counts."""
    height = curve[peak]
    after = peak
    while after < len(curve) - 1 and curve[after] == height:
        after += 1
    if not (curve[peak - 1] < height and curve[after] < height):
        return 0.0
    lows = []
    for direction in (-1, 1):
        low, at = height, peak
        while 0 <= at < len(curve) and curve[at] <= height:
            low, at = min(low, curve[at]), at + direction
        lows.append(low)
    return height - max(lows)
