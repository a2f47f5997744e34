"""Data sets of the second generator: tissue, motions, hidden effects of a wanted noncentrality, and the truth."""

from dataclasses import dataclass, replace

import numpy as np
from second_generator_effects import LIBRARY
from second_generator_hidden import Hidden, Kind, hidden_force
from second_generator_kinds import OUTSIDE
from second_generator_law import Insertion, Tissue
from second_generator_motion import MOTIONS, RATES_HZ, draw_motions
from second_generator_noise import Noise, draw_field, draw_noise, heterogeneity_columns, unabsorbed

STRATA = ((5.0, 30.0), (30.0, 70.0), (70.0, 100.0), (100.0, 300.0), (300.0, 30000.0))  # noncentrality
RMS_RANGE = (0.5, 50.0)  # of an effect, in noise RMS; the lower bound yields to the stratum
SIZING_STEPS = 3  # simulations to find the size of an effect that is not linear in it
NOISE_S = 12.0  # duration of the noise record
LAG_S = 0.004  # standard deviation of the sensor lag in `noncentrality_if_the_lag_is_free`
SCATTER = 0.08  # standard deviation of a parameter between trials, relative
HETEROGENEITIES = (0.0, 0.03, 0.1)
KINDS = ("none", "single", "pair", "outside")
INVISIBLE = ("gain_error", "ageing")  # the base model, calibrated to each trial, takes them up
SIZES = ("noise", "tissue", "rms")
MIXTURE = ("none", "single", "single", "pair", "single", "outside", "none", "single", "pair", "outside")


@dataclass(frozen=True)
class Wish:
    """What a data set is to contain. `index` and `seed` determine everything else.

    `number` counts the data sets of the same kind. `sizes` says by what the sizes are drawn: by the noncentrality
    against the `noise` alone, by that against noise and heterogeneous `tissue`, or by the `rms` (log-uniform between
    the bounds of `RMS_RANGE`).
    """

    seed: int
    index: int
    number: int
    kind: str
    motion: str
    rate_hz: int
    heterogeneity: float
    sizes: str = "noise"


@dataclass(frozen=True)
class DataSet:
    """Trials without (`bases`) and with the effects (`forces`, sampled, without noise), and what is true of them."""

    wish: Wish
    nominal: dict[str, float]
    bases: list[Insertion]
    forces: list[np.ndarray]
    measured: list[np.ndarray]
    noise: Noise
    noise_record: np.ndarray
    truth: dict[str, object]


class Sizing:
    """Noncentrality and RMS of hidden effects in the training trials of one data set."""

    def __init__(self, trials: list[Insertion], noise: Noise, heterogeneity: float, length_mm: float) -> None:
        self.trials, self.noise = trials, noise
        self.base = [each.base_sensitivities() for each in trials]
        self.plain = [each.sampled(each.force) for each in trials]
        self.lag = [
            LAG_S * np.gradient(each)[:, None] * trial.rate_hz for each, trial in zip(self.plain, trials, strict=True)
        ]
        self.random = [
            heterogeneity_columns(each, heterogeneity, length_mm) if heterogeneity else None for each in trials
        ]

    def signals(self, hidden: list[Hidden]) -> list[np.ndarray]:
        """Sampled hidden force of each trial."""
        return [
            trial.sampled(hidden_force(trial, hidden, number)) - plain
            for number, (trial, plain) in enumerate(zip(self.trials, self.plain, strict=True))
        ]

    def noncentrality(
        self,
        signals: list[np.ndarray],
        others: list[np.ndarray] | None = None,
        *,
        tissue: bool = False,
        lag: bool = False,
    ) -> float:
        """Energy that the base model leaves.

        With `tissue`, heterogeneity explains what it can; with `lag`, so does a lag of the sensor with a prior of
        `LAG_S`; with `others`, so does a second signal with one amplitude for all trials.
        """
        random = self.random if tissue else self.lag if lag else [None] * len(self.base)
        parts = list(zip(signals, self.base, random, strict=True))
        own = sum(unabsorbed(signal, base, self.noise, other) for signal, base, other in parts)
        if others is None:
            return own
        second = sum(unabsorbed(each, base, self.noise) for each, base in zip(others, self.base, strict=True))
        # energy of sums gives the product of the two projected signals
        both = sum(
            unabsorbed(one + two, base, self.noise) for one, two, base in zip(signals, others, self.base, strict=True)
        )
        product = (both - own - second) / 2
        return own if second <= 0 else max(own - product**2 / second, 0.0)

    def rms(self, signals: list[np.ndarray]) -> float:
        """RMS over all trials, N."""
        return float(np.sqrt(np.mean(np.concatenate(signals) ** 2)))

    def sized(self, kind: Kind, numbers: dict[str, float], wanted: float, by: str) -> Hidden:
        """Size with the wanted noncentrality (`by` rms: noise multiple), within the bounds of size and RMS."""
        size = kind.size
        for _ in range(1 if kind.linear else SIZING_STEPS):
            signals = self.signals([Hidden(kind, size, numbers)])
            multiple = self.rms(signals) / self.noise.rms_n
            reached = multiple**2 if by == "rms" else self.noncentrality(signals, tissue=by == "tissue")
            if multiple <= 0:
                break
            factor = np.sqrt((wanted**2 if by == "rms" else wanted) / max(reached, 1e-9))
            if by != "rms" and wanted >= STRATA[-1][0]:
                factor = max(factor, RMS_RANGE[0] / multiple)
            following = float(np.clip(size * min(factor, RMS_RANGE[1] / multiple), kind.low, kind.high))
            close, size = abs(following - size) < 0.03 * size, following
            if close:
                break
        return Hidden(kind, float(f"{size:.6g}"), numbers)


def wishes(
    seed: int,
    sets: int,
    kind: str | None,
    rate_hz: int | None,
    heterogeneity: float | None,
    motion: str | None,
    sizes: str,
) -> list[Wish]:
    """One wish for each data set; what is not given goes through its values in a mixed order."""
    rng = np.random.default_rng([seed, 17])
    mixed_rates = [int(rng.choice(RATES_HZ)) for _ in range(sets)]
    mixed_tissue = [float(rng.choice(HETEROGENEITIES)) for _ in range(sets)]
    mixed_motion = [str(rng.choice(MOTIONS, p=(0.6, 0.2, 0.2))) for _ in range(sets)]
    kinds = [kind or MIXTURE[index % len(MIXTURE)] for index in range(sets)]
    return [
        Wish(
            seed,
            index,
            kinds[:index].count(kinds[index]),
            kinds[index],
            motion or mixed_motion[index],
            rate_hz or mixed_rates[index],
            mixed_tissue[index] if heterogeneity is None else heterogeneity,
            sizes,
        )
        for index in range(sets)
    ]


def _library(wish: Wish) -> list[Kind]:
    """Kinds in the order of the seed, beginning with the one whose turn it is."""
    library = {"single": LIBRARY, "pair": LIBRARY, "outside": OUTSIDE}.get(wish.kind, ())
    order = np.random.default_rng([wish.seed, KINDS.index(wish.kind)]).permutation(len(library))
    if wish.kind == "pair":  # beside another effect a gain error cannot be counted
        order = [each for each in order if library[each].name != INVISIBLE[0]]
    place = wish.number % max(len(order), 1)
    return [library[each] for each in (*order[place:], *order[:place])]


def _hide(rng: np.random.Generator, wish: Wish, sizing: Sizing) -> list[Hidden]:
    """Draws the hidden effects; a kind that the motions do not excite gives its turn to the next one."""
    kinds = _library(wish)
    # each kind goes through the strata, in its turns and from kind to kind
    turn, place = divmod(wish.number, max(len(kinds), 1))
    strata = [STRATA[(place + turn) % len(STRATA)]]
    if wish.kind == "pair":
        # half of the pairs are in the same stratum, the others in any
        strata.append(strata[0] if rng.random() < 0.5 else STRATA[int(rng.integers(len(STRATA)))])
    hidden: list[Hidden] = []
    for number, stratum in enumerate(strata if kinds else []):
        if number:
            rng.shuffle(kinds)
        low, high = RMS_RANGE if wish.sizes == "rms" else stratum
        wanted = float(np.exp(rng.uniform(np.log(low), np.log(high))))
        for kind in kinds:
            if any(each.kind is kind for each in hidden):
                continue
            found = sizing.sized(kind, kind.draw(rng), wanted, wish.sizes)
            if kind.name in INVISIBLE or sizing.noncentrality(sizing.signals([found])) > 1:
                hidden.append(found)
                break
    return hidden


def _draw_trials(rng: np.random.Generator, wish: Wish, nominal: dict[str, float], length_mm: float) -> list[Insertion]:
    tissues = []
    motions = draw_motions(rng, wish.motion, int(rng.integers(2, 4)))
    for _ in motions:
        tissue = Tissue(**{name: value * float(np.exp(SCATTER * rng.normal())) for name, value in nominal.items()})
        if wish.heterogeneity:
            fields = [np.maximum(draw_field(rng, wish.heterogeneity, length_mm), -0.8) for _ in range(2)]
            tissue = replace(tissue, shaft_field=fields[0], tip_field=fields[1])
        tissues.append(tissue)
    return [Insertion.of(motion, tissue, wish.rate_hz) for motion, tissue in zip(motions, tissues, strict=True)]


def make(wish: Wish) -> DataSet:
    """Draws one data set; the same wish gives the same numbers."""
    rng = np.random.default_rng([wish.seed, wish.index])
    nominal = {
        "friction": 0.035 * float(np.exp(rng.normal(0, 0.12))),
        "cutting": float(rng.uniform(0.3, 0.7)),
        "onset_mm": float(rng.uniform(2.5, 5.0)),
        "presliding_mm": float(np.exp(rng.uniform(np.log(0.03), np.log(0.35)))),
    }
    length_mm = float(rng.uniform(3.0, 7.0))
    noise = draw_noise(rng, wish.rate_hz)
    bases = _draw_trials(rng, wish, nominal, length_mm)
    sizing = Sizing(bases[:-1], noise, wish.heterogeneity, length_mm)
    hidden = _hide(rng, wish, sizing)
    signals = [sizing.signals([each]) for each in hidden]
    forces = [each.sampled(hidden_force(each, hidden, number)) for number, each in enumerate(bases)]
    measured = [np.round(force + noise.draw(rng, len(force)), 5) for force in forces]
    record = np.round(noise.draw(rng, int(NOISE_S * wish.rate_hz)), 5)
    truth = _truth(wish, nominal, length_mm, bases, forces, noise, hidden, signals, sizing)
    return DataSet(wish, nominal, bases, forces, measured, noise, record, truth)


def draw_references(data: DataSet, count: int) -> list[tuple[Insertion, np.ndarray]]:
    """Further trials of the same base without the effects, at most four, with their measured forces, N."""
    rng = np.random.default_rng([data.wish.seed, data.wish.index, 1])
    trials = _draw_trials(rng, data.wish, data.nominal, float(data.truth["heterogeneity_length_mm"]))[:count]
    return [(each, np.round(each.sampled(each.force) + data.noise.draw(rng, each.samples), 5)) for each in trials]


def _truth(
    wish: Wish,
    nominal: dict[str, float],
    length_mm: float,
    bases: list[Insertion],
    forces: list[np.ndarray],
    noise: Noise,
    hidden: list[Hidden],
    signals: list[list[np.ndarray]],
    sizing: Sizing,
) -> dict[str, object]:
    held = Sizing(bases[-1:], noise, 0.0, length_mm) if hidden else None
    effects = []
    for number, (each, own) in enumerate(zip(hidden, signals, strict=True)):
        value = sizing.noncentrality(own)
        others = signals[1 - number] if len(hidden) == 2 else None
        # in the held-out trial the number of the trial goes on, as in the simulation
        last = held.trials[0].sampled(hidden_force(bases[-1], [each], len(bases) - 1)) - held.plain[0]
        effects.append(
            {
                "name": each.kind.name,
                "library": each.kind.library,
                "axis": each.kind.axis,
                "axes_also_right": list(each.kind.also),
                "formula": each.kind.formula,
                "size": each.size,
                "unit": each.kind.unit,
                "numbers": each.numbers,
                "rms_n": sizing.rms(own),
                "noise_multiple": sizing.rms(own) / noise.rms_n,
                "noncentrality": value,
                "noncentrality_in_tissue": sizing.noncentrality(own, tissue=True) if wish.heterogeneity else value,
                "noncentrality_beside_the_other": sizing.noncentrality(own, others) if others else value,
                "noncentrality_if_the_lag_is_free": sizing.noncentrality(own, lag=True),
                "noncentrality_held_out": held.noncentrality([last]),
                "stratum": next(
                    index for index, (_, high) in enumerate(STRATA) if value <= high or index == len(STRATA) - 1
                ),
                "at_bound": each.size in (each.kind.low, each.kind.high),
            }
        )
    return {
        "schema": "needleplan.second_generator/1",
        "seed": wish.seed,
        "index": wish.index,
        "kind": wish.kind,
        "motion": wish.motion,
        "rate_hz": wish.rate_hz,
        "sizes_by": wish.sizes,
        "heterogeneity": wish.heterogeneity,
        "heterogeneity_length_mm": length_mm,
        "noise": {"rms_n": noise.rms_n, "colour": noise.colour},
        "hidden": effects,
        "nominal": nominal,
        "trials": [
            {name: getattr(each.tissue, name) for name in nominal}
            | {"duration_s": each.motion.duration_s, "samples": each.samples}
            for each in bases
        ],
        "hidden_rms_by_trial_n": [
            float(np.sqrt(np.mean((force - each.sampled(each.force)) ** 2)))
            for each, force in zip(bases, forces, strict=True)
        ],
    }
