"""Models to fit, use and save."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from stiff_bench.api.data_sets import Dataset, as_dataset, choice_of
from stiff_bench.api.registered import registry
from stiff_bench.api.tables import Text
from stiff_bench.console import say
from stiff_bench.plan.options import Choice
from stiff_bench.plan.registry import OURS
from stiff_bench.plan.request import check_model
from stiff_bench.run.progress import display
from stiff_bench.run.whole_fit import cross_validated_error, left_out_errors, whole_fit
from stiff_bench.tables.fit_notes import springs_table
from stiff_bench.tables.metric_table import metric_lines
from stiff_bench.tables.render import plain_text
from stiff_bench.tables.table import Table
from stiff_bench.tables.units import MM, counted
from stiff_datasets.measured.rows_beyond_training import extrapolation_warning
from stiff_protocols.contract.errors import (
    ConfigError,
    DataError,
    NotFittedError,
    StiffBenchError,
    said_by,
    warn,
)
from stiff_protocols.contract.files import check_new_file
from stiff_protocols.contract.plugin import ModelInfo, in_words
from stiff_protocols.contract.screen import Screen, Shown
from stiff_protocols.contract.source_code import code_of
from stiff_protocols.contract.stiffness_model import offers, optional
from stiff_protocols.contract.training_range import TrainingRange
from stiff_protocols.contract.types import (
    AXES,
    BenchmarkData,
    FloatArray,
    Interval,
    Prediction,
    Robot,
    check_coverage,
    frozen_array,
)
from stiff_protocols.scoring.conformal import calibration_samples_needed, conformal_interval
from stiff_protocols.scoring.cross_validated import CrossValidatedError

if TYPE_CHECKING:
    from pandas import DataFrame

    from stiff_bench.figures.prepared_figure import Prepared

MOST_NUMBERS = 4
"""Reported numbers that a short view of a model shows."""


class Model(Shown):
    """A stiffness model: the benchmarked one, with what `fit` learned.

    Attributes:
        choice: which model, with its options.
        fitted: the model itself, of stiffbench's contract or a plugin's class; None before `fit`.
        note: how the number of epochs was chosen; "" where there is nothing to choose.
        data: data set of the last `fit`, with its seed; None for a model of a file.
        file: that it was read from; None where it was not.
    """

    def __init__(self, choice: Choice[ModelInfo]) -> None:
        """Store the argument."""
        self.choice = choice
        self.fitted: Any = None
        self.note = ""
        self.data: tuple[Dataset, int] | None = None
        self.file: Path | None = None
        self._has_warned = False

    @property
    def name(self) -> str:
        """Key with the options that differ from their defaults."""
        return self.choice.name

    def fit(
        self,
        data: Dataset | BenchmarkData | DataFrame,
        *,
        robot: str | Robot | None = None,
        seed: int = 0,
    ) -> Self:
        """Fit the model to all samples of a data set.

        As in a benchmark, a model that chooses its epoch on validation rows (``training="best"``)
        gets a fifth of the poses for that; every other one learns from all, the networks with as
        many epochs as cross-validation finds best.

        Args:
            data: samples and their robot, or a DataFrame with the columns of a file (deg, N, N m,
                mm), which is checked as a file is.
            robot: of a DataFrame: the name of a shipped robot, or a `Robot`.
            seed: of the model, and of the poses that choose the epoch.

        Raises:
            ConfigError: the model cannot be used here, or not for this robot, or `data` is not a
                data set; or a DataFrame has no robot.
            DataError: a column is missing, or a value is not valid; see `Dataset.from_frame`.
            ModelError: the samples cannot be fitted.
        """
        data = as_dataset(data, robot)
        with display():
            self.fitted, self.note = whole_fit(self.choice, data.samples, data.robot, seed=seed)
        self.data = data, seed
        self._has_warned = False
        return self

    def predict(self, q: FloatArray | DataFrame, wrench: FloatArray | None = None) -> FloatArray:
        """Return (n, 3) the deflections of the TCP, m, base frame.

        The first call with rows that are unlike the training samples warns of them, with numbers;
        ``model.training_range.extrapolates(q, wrench)`` has the rule, and says it of every row.

        Args:
            q: (n, n_joints) joint positions, rad or m; or a DataFrame of poses and loads with the
                columns of a file (deg, N, N m), which is checked as a file is.
            wrench: (n, 6) force [N] and torque [N m] at the TCP, base frame; None with a DataFrame.

        Raises:
            NotFittedError: `fit` was not called.
            DataError: a column is missing, or a value is not valid; rows count from 0.
            ModelError: the shapes are not those of the robot.
        """
        q, wrench = self._loads(q, wrench)
        predicted = np.asarray(self.fitted.predict(q, wrench))
        if not self._has_warned:
            known, rows = self.training_range, (np.asarray(q), np.asarray(wrench))
            words = known.extrapolates(*rows)
            warning = extrapolation_warning(known, self.fitted.robot_, *rows, words)
            self._has_warned = bool(warning)
            if warning:
                warn(warning)
        return predicted

    def predict_at_tcp(self, q: FloatArray, wrench: FloatArray) -> FloatArray:
        """Return the (n, 3) deflection of the TCP, m, base frame.

        A model that was fitted to another point of the tool carries it over to the TCP. Arguments
        and errors as of `predict` with arrays.
        """
        self.check_fitted()
        with blamed_on(self.file):
            predicted = optional(self.fitted, "predict_at_tcp")(q, wrench)
            return frozen_array(predicted, "the prediction", (len(q), len(AXES)))

    def _loads(
        self, q: FloatArray | DataFrame, wrench: FloatArray | None
    ) -> tuple[FloatArray, FloatArray]:
        """Return (n, n_joints) joint positions and (n, 6) wrenches, SI units, of a DataFrame too.

        Raises:
            NotFittedError: `fit` was not called.
            ConfigError: the wrench is missing, or given twice.
            DataError: a column of a DataFrame is missing, or a value is not valid.
        """
        from pandas import DataFrame

        self.check_fitted()
        if not isinstance(q, DataFrame):
            if wrench is None:
                raise ConfigError("is missing: (n, 6) N and N m; a DataFrame has its own", "wrench")
            return q, wrench
        from stiff_datasets.measured.load_file import loads_of

        if wrench is not None:
            raise ConfigError("is in the DataFrame already; leave it out", "wrench")
        loads = loads_of("loads", q, self.fitted.robot_)
        for oddity in loads.oddities:
            warn(oddity, stacklevel=3)
        return loads.q, loads.wrench

    def predict_interval(
        self,
        q: FloatArray | DataFrame,
        wrench: FloatArray | None = None,
        coverage: float = 0.9,
    ) -> Interval:
        """Return intervals that hold the deflections with a probability, m, per axis, base frame.

        A model without intervals of its own gets split-conformal ones: a second fit leaves a
        quarter of the poses out, and its errors there are the half widths. The first call after
        `fit` makes that fit; `save` keeps the errors with the model. Away from the training samples
        intervals are wider, as ``model.training_range.widened`` says.

        Args:
            q: (n, n_joints) joint positions, rad or m; or a DataFrame, see `predict`.
            wrench: (n, 6) force [N] and torque [N m] at the TCP, base frame; None with a DataFrame.
            coverage: probability (0..1) on each axis.

        Raises:
            NotFittedError: `fit` was not called.
            DataError: a column of a DataFrame is missing, or a value is not valid.
            ConfigError: the coverage does not lie between 0 and 1, or needs more poses than there
                were.
            ModelError: the shapes are not those of the robot.
        """
        self.check_coverage(coverage)
        q, wrench = self._loads(q, wrench)
        if offers(self.fitted, "predict_interval"):
            interval: Interval = self.fitted.predict_interval(q, wrench, coverage)
            return interval
        return conformal_interval(
            self.fitted.predict, self.training_range, self.left_out_errors, q, wrench, coverage
        )

    @property
    def left_out_errors(self) -> FloatArray:
        """(n, 3) m, errors at left-out poses, which the intervals of this model come from.

        Raises:
            NotFittedError: `fit` was not called.
            ConfigError: the model of a file has none.
        """
        self.check_fitted()
        errors = getattr(self.fitted, "left_out_errors_", None)
        if errors is None:
            if self.data is None:
                raise ConfigError(f"{self.file}: has no intervals; fit the model again", "coverage")
            data, seed = self.data
            with display():
                errors = left_out_errors(self.choice, data.samples, data.robot, seed=seed)
            self.fitted.left_out_errors_ = errors
        return frozen_array(errors, "left-out errors", (None, len(AXES)))

    @property
    def cross_validated_error(self) -> CrossValidatedError | None:
        """Error at poses that fits of this model to the same data left out; None: not stored.

        The first use after `fit` makes these fits, one for each fifth of the poses; `save` keeps
        the error with the model.

        Raises:
            NotFittedError: `fit` was not called.
            StiffBenchError: the data have one pose, or cannot be fitted without a fifth of them.
        """
        self.check_fitted()
        stored = getattr(self.fitted, "cross_validated_error_", None)
        if stored is None and self.data is not None:
            data, seed = self.data
            with display():
                stored = cross_validated_error(self.choice, data.samples, data.robot, seed=seed)
            self.fitted.cross_validated_error_ = stored
        if not isinstance(stored, CrossValidatedError | None):
            raise DataError(f"{self.file}: its cross-validated error is a {type(stored).__name__}")
        return stored

    @property
    def training_range(self) -> TrainingRange:
        """Joint positions and loads of the samples that it was fitted to; saved with the model.

        Raises:
            NotFittedError: `fit` was not called.
        """
        self.check_fitted()
        training_range: TrainingRange = self.fitted.training_range_
        return training_range

    def predict_file(
        self,
        loads: Path | str,
        output: Path | str,
        *,
        coverage: float | None = None,
        sheet: str | None = None,
    ) -> int:
        """Predict the deflections of a file's rows, write them, and return how many rows it has.

        The column ``extrapolates`` names what is unlike the training samples, where a prediction is
        a guess: ``joints`` or ``pose-gap``, ``load`` or ``load-gap``, as
        `TrainingRange.extrapolates` defines them; it is empty elsewhere. One warning has the
        numbers.

        Args:
            loads: a file of poses and wrenches, in the columns of a measurement.
            output: a new file: the same rows with ``dx_mm, dy_mm, dz_mm``.
            coverage: of intervals that are written, too (0..1); None: none are.
            sheet: of an Excel file of loads; None: the only one that holds a table.

        Raises:
            NotFittedError: `fit` was not called.
            ConfigError: the coverage of intervals does not lie between 0 and 1, or needs more
                training poses than there were.
            DataError: the loads cannot be read, or the model that was read from a file is broken.
            StoreError: the output cannot be written, or exists.
        """
        from stiff_datasets.measured.load_file import read_loads, write_predictions

        self.check_fitted()
        check_new_file(Path(output))
        model, interval = self.fitted, None
        self.check_coverage(coverage)
        with blamed_on(self.file, but=StiffBenchError):  # which is of the loads
            table = read_loads(Path(loads), model.robot_, sheet)
        for oddity in table.oddities:
            say(f"warning: {oddity}")
        with blamed_on(self.file):
            if coverage is not None:
                interval = self.predict_interval(table.q, table.wrench, coverage)
            predicted = frozen_array(
                model.predict(table.q, table.wrench), "the prediction", (len(table.q), 3)
            )
            known, rows = self.training_range, (table.q, table.wrench)
            extrapolates = known.extrapolates(*rows)
            warning = extrapolation_warning(known, model.robot_, *rows, extrapolates)
        write_predictions(Path(output), table, predicted, extrapolates, interval)
        if warning:
            text = f"{warning}; see the column extrapolates"
            warn(text)
        return len(extrapolates)

    def export(self, file: Path | str) -> Text:
        """Write a network as ONNX, and return its inputs and output with units and frame.

        Raises:
            NotFittedError: `fit` was not called.
            ConfigError: the model is no network, or a package is missing.
            StoreError: the file cannot be written, or exists.
        """
        self.check_fitted()
        check_new_file(Path(file))
        from stiff_models.networks.onnx_export import export_onnx

        export_onnx(self.fitted, Path(file))
        robot = self.fitted.robot_
        return Text(
            f"{file}: {self.name}, robot {robot.name}; inputs q (n, {robot.n_joints}) rad or m, "
            "wrench (n, 6) N and N m at the TCP; output deflection (n, 3) m; base frame, float64"
        )

    def check_fitted(self) -> None:
        """See that it is fitted."""
        if self.fitted is None:
            raise NotFittedError(f"{self.name}: call fit first")

    def check_coverage(self, coverage: float | None) -> None:
        """See that the model has intervals of this coverage, where some are asked for."""
        if coverage is None:
            return
        check_coverage(coverage)
        self.check_fitted()
        if offers(self.fitted, "predict_interval"):
            return
        n = len(self.left_out_errors)
        if n < calibration_samples_needed(coverage):
            raise ConfigError(
                f"{coverage:g}: {self.choice.info.key} left {n} poses out for its intervals, which "
                f"allow at most {n / (n + 1.0):.4g}; more measured poses allow more",
                "coverage",
            )

    def score(self, data: Dataset | BenchmarkData | DataFrame) -> DataFrame:
        """Return the errors on a data set: a row a metric and axis, with its unit.

        A DataFrame has the columns of a file (deg, N, N m, mm) and is of the model's robot.

        Raises:
            NotFittedError: `fit` was not called.
            ConfigError: `data` is not a data set.
            DataError: a column is missing, or a value is not valid; see `Dataset.from_frame`.
        """
        from pandas import DataFrame

        self.check_fitted()
        robot = self.fitted.robot_ if isinstance(data, DataFrame) else None
        samples = as_dataset(data, robot).samples
        predicted = self.predict(samples.q, samples.wrench)
        prediction = Prediction(np.arange(len(samples)), predicted, samples.deflection)
        return DataFrame(metric_lines(prediction))

    def plot(self) -> Prepared:
        """Return the picture of the robot under its largest predicted deflection.

        Raises:
            NotFittedError: the model is not fitted.
            ModelError: no joint spring explains the predictions.
        """
        from stiff_bench.figures.robot_picture import model_picture

        self.check_fitted()
        return model_picture(self.fitted, self.name)

    @property
    def diagnostics(self) -> dict[str, float]:
        """Numbers that the fit reports, by name and unit, such as identified stiffnesses."""
        return dict(getattr(self.fitted, "diagnostics_", {}))

    @property
    def learned(self) -> list[str]:
        """Lines that say what the fit found: springs, chosen options, and what else it reports."""
        numbers, lines = self.diagnostics, []
        if springs := getattr(self.fitted, "springs_", None):
            lines = ["", plain_text(springs_table(springs)), ""]
            of_springs = springs.report()
            numbers = {key: numbers[key] for key in numbers if key not in of_springs}
        if chosen := getattr(self.fitted, "best_params_", None):
            lines.append(f"- options chosen by inner cross-validation: {in_words(chosen)}")
        texts = {name: f"{value:.4g}" for name, value in numbers.items()}
        for name in numbers:
            of_name = name.replace(" standard error", "")
            if of_name != name and of_name in texts:
                texts[of_name] += f" ± {texts.pop(name)} (standard error)"
        return [*lines, *(f"- {name}: {text}" for name, text in texts.items())]

    def report(self, data: Dataset, seed: int) -> Text:
        """Return what was fitted to which data, what the fit found, and the data's caveats."""
        info = data.choice.info
        lines = [
            f"{self.name}, fitted to {data.name} ({info.kind}, {len(data)} samples), robot "
            f"{data.robot.name}, seed {seed}",
            *self.learned,
            *(f"- {line}" for line in (*info.caveats, self.note) if line),
            f"- {self._error_text()}",
        ]
        return Text("\n".join(lines))

    def _error_text(self) -> str:
        """Say how far the fit is off at left-out poses, or that nobody has computed it."""
        stored = getattr(self.fitted, "cross_validated_error_", None)
        if not stored:
            return "Errors on new poses: `bench run`."
        return (
            f"3-D error at left-out poses, cross-validated in {stored.n_folds} folds: "
            f"{MM * stored.mean:.3g} mm mean, {MM * stored.rms:.3g} mm RMS, 90 % within "
            f"{MM * stored.quantile_90:.3g} mm"
        )

    def save(self, file: Path | str, *, cross_validate: bool = True) -> None:
        """Write the fitted model to a file, which `load_model` and `bench predict` read.

        A file that is there is replaced. After `fit`, further fits give the errors at left-out
        poses that intervals and `cross_validated_error` need, and the file keeps them.

        The file of a plugin's model holds the hash of the plugin's code, and is read only where
        the plugin is named.

        Args:
            file: its path.
            cross_validate: False saves five fits and stores no `cross_validated_error`.

        Raises:
            NotFittedError: `fit` was not called.
            ModelError: it is a class of a script, or holds what no file can.
            StoreError: the file cannot be written.
        """
        from stiff_models.io.model_file import save

        self.check_fitted()
        choice = self.choice
        if self.data is not None and not offers(self.fitted, "predict_interval"):
            self._keep_left_out_errors()
        if self.data is not None and cross_validate:
            self._keep_cross_validated_error()
        is_plugin = choice.cls.__module__ != "__main__" and bool(code_of(choice.cls))
        save(self.fitted, Path(file), {choice.info.key: choice.params} if is_plugin else None)

    def _keep_left_out_errors(self) -> None:
        """Compute what the intervals need; where that fails, the model stays without, and warns."""
        try:
            _ = self.left_out_errors
        except Exception as error:  # whatever a third-party model raises in its second fit
            self.fitted.left_out_errors_ = np.empty((0, len(AXES)))
            text = f"{self.name} is saved without intervals: {said_by(error)}"
            warn(text, stacklevel=3)

    def _keep_cross_validated_error(self) -> None:
        """Compute the error at left-out poses; where that fails, there is none, and a warning."""
        try:
            _ = self.cross_validated_error
        except Exception as error:  # whatever a third-party model raises in another fit
            text = f"{self.name} is saved without a cross-validated error: {said_by(error)}"
            warn(text, stacklevel=3)

    def view(self) -> Screen:
        """Return whether it is fitted, to which data, and the parameters that it learned."""
        info = self.choice.info
        facts = [("what it is", info.summary)]
        if self.fitted is None:
            return Screen(f"Model {self.name}, not fitted", [fact for fact in facts if fact[1]])
        if self.data is not None:
            data, seed = self.data
            kind, n = data.choice.info.kind, counted(len(data), "sample")
            facts.append(("fitted to", f"{data.name} ({kind}), {n}, seed {seed}"))
        if self.file is not None:
            facts.append(("read from", str(self.file)))
        facts.append(("robot", self.fitted.robot_.summary))
        if chosen := getattr(self.fitted, "best_params_", None):
            facts.append(("options chosen", in_words(chosen)))
        facts.append(("number of epochs", self.note))
        if getattr(self.fitted, "cross_validated_error_", None):
            facts.append(("accuracy", self._error_text()))
        table, springs = Table("", [], []), getattr(self.fitted, "springs_", None)
        numbers = self.diagnostics
        if springs:
            table = springs_table(springs)
            numbers = {name: x for name, x in numbers.items() if name not in springs.report()}
        facts += [(name, f"{value:.4g}") for name, value in [*numbers.items()][:MOST_NUMBERS]]
        if len(numbers) > MOST_NUMBERS:
            facts.append(("more", f"{len(numbers) - MOST_NUMBERS} numbers in .diagnostics"))
        facts = [fact for fact in facts if fact[1]]
        headings = table.headings()
        return Screen(f"Model {self.name}, fitted", facts, headings, table.texts(), table.notes)


def model_choice(model: str | type | Model, options: dict[str, Any]) -> Choice[ModelInfo]:
    """Return what a name, a class or a model stands for."""
    if isinstance(model, Model):
        choice = model.choice
    elif isinstance(model, str):
        choice = choice_of("model", model, options)
    else:
        info = ModelInfo(key=model.__name__, target=model, summary="")
        choice = Choice(info, model, dict(options), {})
    check_model(choice)
    return choice


def make_model(model: str | type, **options: Any) -> Model:
    """Return a model that is not fitted.

    Args:
        model: its key, such as "ft-mlp" or "sklearn:ensemble.RandomForestRegressor", a word with
            options, "ft-mlp@freeze=full", or a class of yours that keeps the contract.
        options: of it; `bench show NAME` lists them.

    Raises:
        ConfigError: the name or an option is unknown, or a value is wrong.
    """
    return Model(model_choice(model, options))


def load_model(file: Path | str) -> Model:
    """Return the fitted model that `Model.save` or `bench fit` wrote.

    Raises:
        DataError: the file cannot be read, is damaged, or holds a plugin's model that
            `use_plugin` was not called for, or whose code has changed.
    """
    from stiff_models.io.model_file import key_of, load

    known = registry()
    plugins = {key: info.load() for key, info in known.models.items() if known.origins[key] != OURS}
    fitted = load(file, plugins)
    keys = [key for key, cls in plugins.items() if type(fitted) is cls]
    choice: Choice[ModelInfo] = Choice.of(known.model(keys[0] if keys else key_of(fitted)))
    model = Model(choice if keys else replace(choice, params=fitted.get_params(deep=False)))
    model.fitted, model.file = fitted, Path(file)
    return model


@contextmanager
def blamed_on(model_file: Path | None, but: tuple[()] | type[Exception] = ()) -> Iterator[None]:
    """Make one clear error of whatever a model from a crafted file raises, `but` for some."""
    try:
        yield
    except but:
        raise
    except Exception as error:
        if model_file is None:
            raise
        kind = "" if isinstance(error, StiffBenchError) else f"{type(error).__name__}: "
        raise DataError(f"{model_file}: its model cannot predict: {kind}{error}") from error
