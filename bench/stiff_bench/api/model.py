"""Fit, use and save models."""

from __future__ import annotations

import inspect
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Self

import numpy as np

from stiff_bench.analysis.extrapolation import extrapolation_warning
from stiff_bench.api.data_sets import Dataset, as_dataset, choice_of, degrees_text, path_of
from stiff_bench.api.robots import same_geometry
from stiff_bench.console import say
from stiff_bench.parameter_types import FilePath, Fraction
from stiff_bench.plan.fits import DEFAULT_COVERAGE, check_model
from stiff_bench.plan.options import Choice
from stiff_bench.plan.registry import OURS, registry
from stiff_bench.results.fit_values import metric_lines
from stiff_bench.run.final_fit import cross_validated_error, final_fit, left_out_errors
from stiff_bench.run.progress import display
from stiff_bench.tables.table import Column, Entry, Quantity, Table
from stiff_bench.tables.units import MM, counted, percent
from stiff_bench.tables.writers import Text, plain_text
from stiff_protocols.contract.display import Screen, ShownObject
from stiff_protocols.contract.errors import (
    ConfigError,
    DataError,
    NotFittedError,
    StiffBenchError,
    describe_error,
    warn,
)
from stiff_protocols.contract.files import check_new_file, written_whole
from stiff_protocols.contract.plugin import ModelInfo, in_words
from stiff_protocols.contract.source_code import code_of
from stiff_protocols.contract.stiffness_model import offers, optional, predicted_readings
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
from stiff_protocols.springs.identification import CONTRIBUTION, HIGH_END, LOW_END

if TYPE_CHECKING:
    from pandas import DataFrame

    from stiff_bench.figures.prepared_figure import Prepared
    from stiff_protocols.springs.identification import IdentifiedSprings

MEAN_ERROR = "expected error, mean at left-out poses"
MOST_NUMBERS = 4
"""Largest number of diagnostics in the short view of a model."""


def half_width_name(coverage: float) -> str:
    """Return the name of an interval's half width in texts: "90 % interval, half width"."""
    return f"{percent(coverage)} interval, half width"


class Model(ShownObject):
    """A stiffness model of the benchmark, with its fit.

    Attributes:
        choice: model with its options.
        fitted: fitted object of stiffbench's or a plugin's class; None before `fit`.
        note: method that chose the number of epochs; "" without a choice.
        data: data set of the last `fit`, with its seed; None for a model from a file.
        file: file of the model; None for a model that was not read from a file.
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
        """Return the key with the options that differ from their defaults."""
        return self.choice.name

    def fit(
        self,
        data: Dataset | BenchmarkData | DataFrame,
        *,
        robot: str | Robot | None = None,
        seed: int = 0,
    ) -> Self:
        """Fit the model to all samples of a data set.

        As in a benchmark, a model with ``training="best"`` uses a fifth of the poses as validation
        rows to choose its epoch. All other models are trained on all poses; networks use the best
        number of epochs of a cross-validation.

        Args:
            data: samples and their robot, or a DataFrame with the columns of a file (deg, N, N m,
                mm), which is checked like a file.
            robot: robot of a DataFrame: the name of a shipped robot, or a `Robot`.
            seed: seed of the model, and of the choice of validation poses.

        Raises:
            ConfigError: the model cannot be used here or for this robot, `data` is not a data set,
                or a DataFrame has no robot.
            DataError: a column is missing, or a value is not valid; see `Dataset.from_frame`.
            ModelError: the samples cannot be fitted.
        """
        data = as_dataset(data, robot)
        with display():
            self.fitted, self.note = final_fit(self.choice, data.samples, data.robot, seed=seed)
        self.data = data, seed
        self._has_warned = False
        return self

    def predict(
        self, q: FloatArray | DataFrame | Dataset, wrench: FloatArray | None = None
    ) -> FloatArray:
        """Return the (n, 3) deflections of the TCP, m, base frame.

        The first call with rows beyond the training range warns about them, with numbers. Use
        ``model.training_range.extrapolates(q, wrench)`` to check each row.

        Args:
            q: (n, n_joints) joint positions, rad or m; or a data set of the model's robot; or a
                DataFrame of poses and loads with the columns of a file (deg, N, N m), which is
                checked like a file.
            wrench: (n, 6) force [N] and torque [N m] at the TCP, base frame; None with a table.

        Raises:
            NotFittedError: `fit` was not called.
            ConfigError: the wrench is missing, or given twice, or a data set is of another robot.
            DataError: a column is missing, or a value is not valid; rows count from 0.
            ModelError: the shapes do not match the robot.
        """
        q, wrench = self._loads(q, wrench)
        predicted = np.asarray(self.fitted.predict(q, wrench))
        self._warn_beyond_training(np.asarray(q), np.asarray(wrench))
        return predicted

    def _warn_beyond_training(self, q: FloatArray, wrench: FloatArray) -> None:
        """Warn once of (n, n_joints) q and (n, 6) wrenches beyond the training range."""
        if self._has_warned:
            return
        training_range, robot = self.training_range, self.fitted.robot_
        words = training_range.extrapolates(q, wrench)
        warning = extrapolation_warning(training_range, robot, q, wrench, words)
        self._has_warned = bool(warning)
        if warning:
            warn(warning, stacklevel=3)

    def predict_at_tcp(self, q: FloatArray, wrench: FloatArray) -> FloatArray:
        """Return the (n, 3) deflection of the TCP, m, base frame.

        A model fitted at another tool point transforms its prediction to the TCP. Arguments and
        errors are the same as for `predict` with arrays.
        """
        self.check_fitted()
        with wrap_model_errors(self.file):
            predicted = optional(self.fitted, "predict_at_tcp")(q, wrench)
            return frozen_array(predicted, "the prediction", (len(q), len(AXES)))

    def _loads(
        self, q: FloatArray | DataFrame | Dataset, wrench: FloatArray | None
    ) -> tuple[FloatArray, FloatArray]:
        """Return (n, n_joints) joint positions and (n, 6) wrenches in SI units.

        Raises:
            NotFittedError: `fit` was not called.
            ConfigError: the wrench is missing, or given twice, or a data set is of another robot.
            DataError: a column of a DataFrame is missing, or a value is not valid.
        """
        self.check_fitted()
        if isinstance(q, Dataset):
            if wrench is not None:
                raise ConfigError("is in the data set already; leave it out", "wrench")
            self._check_robot_of(q)
            return q.samples.q, q.samples.wrench
        if not isinstance(q, np.ndarray):
            from pandas import DataFrame  # takes half a second

            from stiff_datasets.measured.query_file import loads_of

            if isinstance(q, DataFrame):
                if wrench is not None:
                    raise ConfigError("is in the DataFrame already; leave it out", "wrench")
                loads = loads_of("loads", q, self.fitted.robot_)
                for oddity in loads.oddities:
                    warn(oddity, stacklevel=3)
                return loads.q, loads.wrench
        if wrench is None:
            needed = "is missing; give (n, 6) N and N m, or a Dataset or DataFrame in place of q"
            raise ConfigError(needed, "wrench")
        robot = self.fitted.robot_
        if np.shape(q)[1:] == (robot.n_joints,) and (
            in_degrees := degrees_text(np.asarray(q), robot)
        ):
            raise DataError(in_degrees)
        return q, wrench

    def _check_robot_of(self, data: Dataset) -> None:
        """Raise ConfigError if a data set is of another robot or TCP than the model's."""
        robot, fitted = data.robot, self.fitted.robot_
        if not same_geometry(robot, fitted):
            raise ConfigError(
                f"{data.name} is of {robot.summary}, TCP {robot.tcp_text}; {self.name} was fitted "
                f"to {fitted.summary}, TCP {fitted.tcp_text}"
            )

    def predict_interval(
        self,
        q: FloatArray | DataFrame | Dataset,
        wrench: FloatArray | None = None,
        coverage: float = 0.9,
    ) -> Interval:
        """Return prediction intervals of the deflections per axis, m, base frame.

        Models without intervals use split-conformal ones: a second fit leaves out a quarter of the
        poses, and its errors there are the half widths. The first call after `fit` makes this fit;
        `save` stores the errors with the model. Away from the training samples the intervals are
        wider (``model.training_range.widened``).

        Args:
            q: (n, n_joints) joint positions, rad or m; or a table, see `predict`.
            wrench: (n, 6) force [N] and torque [N m] at the TCP, base frame; None with a table.
            coverage: probability (0..1) on each axis.

        Raises:
            NotFittedError: `fit` was not called.
            DataError: a column of a DataFrame is missing, or a value is not valid.
            ConfigError: the coverage is not between 0 and 1, or needs more training poses.
            ModelError: the shapes do not match the robot.
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
        """Return (n, 3) errors at left-out poses, m, the basis of this model's intervals.

        Raises:
            NotFittedError: `fit` was not called.
            ConfigError: the model's file has no errors.
        """
        self.check_fitted()
        errors = getattr(self.fitted, "left_out_errors_", None)
        if errors is None:
            if self.data is None:
                place = self.file or self.name
                raise ConfigError(f"{place}: has no intervals; fit the model again", "coverage")
            data, seed = self.data
            with display():
                errors = left_out_errors(self.choice, data.samples, data.robot, seed=seed)
            self.fitted.left_out_errors_ = errors
        return frozen_array(errors, "left-out errors", (None, len(AXES)))

    @property
    def cross_validated_error(self) -> CrossValidatedError | None:
        """Return the cross-validated error at left-out poses; None: not stored.

        The first use after `fit` makes a fit per fifth of the poses; `save` stores the error with
        the model.

        Raises:
            NotFittedError: `fit` was not called.
            StiffBenchError: there is only one pose, or four fifths of the poses are too few to fit.
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
        """Return the range of joint positions and loads of the training samples.

        Raises:
            NotFittedError: `fit` was not called.
        """
        self.check_fitted()
        training_range: TrainingRange = self.fitted.training_range_
        return training_range

    def predict_file(
        self,
        input: FilePath,
        output: FilePath,
        *,
        coverage: Fraction | None = None,
        sheet: str | None = None,
    ) -> int:
        """Predict the deflections of a file of poses and wrenches.

        The column ``extrapolates`` names what is unlike the training samples: joints, pose-gap,
        load or load-gap. Such a prediction is a guess; a warning gives the numbers.

        Args:
            input: poses and wrenches, in the columns of a measurement; deflections are ignored.
            output: new file: the same rows with dx_mm, dy_mm, dz_mm; on the command line `-` is
                standard output.
            coverage: add prediction intervals of this coverage (0..1), per axis.
            sheet: sheet of an Excel file; by default the only one with a table.

        Returns:
            Number of rows.

        Raises:
            NotFittedError: `fit` was not called.
            ConfigError: the coverage is not between 0 and 1, or needs more training poses.
            DataError: the loads cannot be read, or the model from a file is corrupt.
            StoreError: the output cannot be written, or exists.
        """
        from stiff_datasets.measured.query_file import read_loads, write_predictions

        self.check_fitted()
        check_new_file(Path(output))
        model, interval = self.fitted, None
        self.check_coverage(coverage)
        with wrap_model_errors(self.file, but=StiffBenchError):  # an error of the loads
            table = read_loads(Path(input), model.robot_, sheet)
        for oddity in table.oddities:
            say(f"warning: {oddity}")
        with wrap_model_errors(self.file):
            if coverage is not None:
                interval = self.predict_interval(table.q, table.wrench, coverage)
            predicted = frozen_array(
                model.predict(table.q, table.wrench), "the prediction", (len(table.q), 3)
            )
            training_range, rows = self.training_range, (table.q, table.wrench)
            extrapolates = training_range.extrapolates(*rows)
            warning = extrapolation_warning(training_range, model.robot_, *rows, extrapolates)
        write_predictions(Path(output), table, predicted, extrapolates, interval)
        if warning:
            text = f"{warning}; see the column extrapolates"
            warn(text)
        return len(extrapolates)

    def export(self, output: FilePath, *, format: Literal["onnx", "c"] = "onnx") -> Text:
        """Write a saved network as ONNX, or a spring model or network as C99.

        Args:
            output: new .onnx file; or new .c file, next to which its .h file is written.
            format: ONNX for networks; C for spring models (bayes-springs without its intervals)
                and networks without physics.

        Raises:
            NotFittedError: `fit` was not called.
            ConfigError: the model has no such form, a C file has another suffix, or a package is
                missing.
            StoreError: a file cannot be written, or exists.
        """
        self.check_fitted()
        robot, output = self.fitted.robot_, Path(output)
        files = [output, output.with_suffix(".h")] if format == "c" else [output]
        for file in files:
            check_new_file(file)
        if format == "c":
            from stiff_models.c_export.c_source import export_c

            export_c(self.fitted, output, name=self.name, data=self.data_text)
            form = "C99; deflection(q, wrench, d) and correct(q, wrench, command); q"
        else:
            from stiff_models.networks.onnx_export import export_onnx

            export_onnx(self.fitted, output)
            form = f"inputs q (n, {robot.n_joints})"
        return Text(
            f"{', '.join(map(str, files))}: {self.name}, robot {robot.name}; {form} rad or m, "
            "wrench N and N m at the TCP; output deflection m; base frame, float64"
        )

    @property
    def data_text(self) -> str:
        """Return name, size and sha256 of the training data; of a file as far as it has them."""
        if self.data is None:
            return str(getattr(self.fitted, "data_text_", "not stated in the model file"))
        data = self.data[0]
        return f"{data.name}, {counted(len(data), 'sample')}, sha256 {data.data.sha256}"

    def write_urdf(self, output: FilePath) -> Text:
        """Write the model's robot as URDF, with its fitted TCP and the stiffness of its springs.

        It is the chain that the model was fitted to: joints, limits, masses. The TCP is the last
        link, ``tcp``. Each spring is an element ``stiffness`` of its joint, N m/rad or N/m.

        Args:
            output: new .urdf file.

        Raises:
            NotFittedError: `fit` was not called.
            ConfigError: the model has no stiffness of single joints.
            StoreError: the file cannot be written, or exists.
        """
        from stiff_datasets.robots.urdf_writer import robot_urdf

        self.check_fitted()
        check_new_file(Path(output))
        springs = getattr(self.fitted, "springs_", None)
        if springs is None or not springs.report().keys() <= self.diagnostics.keys():
            valid = "vjm, vjm-full, vjm-multisegment, bayes-springs"
            reason = f"{self.name} has no stiffness of single joints (valid: {valid})"
            raise ConfigError(reason, "urdf-out")
        geometry = getattr(self.fitted, "geometry_", None)
        robot = self.fitted.robot_ if geometry is None else geometry.robot
        with written_whole(Path(output)) as temporary:
            temporary.write_text(robot_urdf(robot, springs), encoding="utf-8")
        return Text(f"{output}: {robot.name}, TCP {robot.tcp_text}, {len(springs.names)} springs")

    def check_fitted(self) -> None:
        """Raise NotFittedError unless the model is fitted."""
        if self.fitted is None:
            raise NotFittedError(f"{self.name}: call fit first")

    def check_coverage(self, coverage: float | None) -> None:
        """Raise ConfigError if the model has no intervals of this coverage."""
        if coverage is None:
            return
        check_coverage(coverage)
        self.check_fitted()
        if offers(self.fitted, "predict_interval"):
            return
        n = len(self.left_out_errors)
        if n < calibration_samples_needed(coverage):
            raise ConfigError(
                f"{coverage:g}: {self.choice.info.key} left out {n} poses for its intervals, which "
                f"allow at most {n / (n + 1.0):.4g}; lower the coverage or measure more poses",
                "coverage",
            )

    def score(self, data: Dataset | BenchmarkData | DataFrame) -> DataFrame:
        """Return the errors on a data set in a row per metric and axis, with units.

        A DataFrame has the columns of a file (deg, N, N m, mm) and belongs to the model's robot. A
        model that tells robot and rig apart is compared by `predict_reading`.

        Raises:
            NotFittedError: `fit` was not called.
            ConfigError: `data` is not a data set, or its robot or TCP is not the model's.
            DataError: a column is missing, or a value is not valid; see `Dataset.from_frame`.
        """
        from pandas import DataFrame

        self.check_fitted()
        robot = self.fitted.robot_ if isinstance(data, DataFrame) else None
        data = as_dataset(data, robot)
        self._check_robot_of(data)
        samples = data.samples
        predicted = predicted_readings(self.fitted, samples.q, samples.wrench, samples.levers)
        self._warn_beyond_training(samples.q, samples.wrench)
        rows = np.arange(len(samples))
        prediction = Prediction(rows, predicted, samples.deflection, directions=samples.directions)
        return DataFrame(metric_lines(prediction))

    def plot(self) -> Prepared:
        """Return the picture of the robot under its largest predicted deflection.

        Raises:
            NotFittedError: the model is not fitted.
            ModelError: joint springs cannot explain the predictions.
        """
        from stiff_bench.figures.robot_picture import model_picture

        self.check_fitted()
        return model_picture(self.fitted, self.name)

    @property
    def diagnostics(self) -> dict[str, float]:
        """Return numbers of the fit by name and unit, such as identified stiffnesses."""
        return dict(getattr(self.fitted, "diagnostics_", {}))

    @property
    def learned(self) -> list[str]:
        """Return lines on the fit: springs, chosen options and other numbers."""
        numbers, lines = self.diagnostics, []
        if springs := getattr(self.fitted, "springs_", None):
            lines = ["", plain_text(_springs_table(springs)), ""]
            of_springs = springs.report()
            numbers = {key: numbers[key] for key in numbers if key not in of_springs}
        if chosen := getattr(self.fitted, "best_params_", None):
            lines.append(f"- options chosen by inner cross-validation: {in_words(chosen)}")
        texts = {name: _number_text(name, value) for name, value in numbers.items()}
        for name in numbers:
            of_name = name.replace(" standard error", "")
            if of_name != name and of_name in texts:
                texts[of_name] += f" ± {texts.pop(name)} (standard error)"
            of_name = name.replace(f" {LOW_END}", "")
            if of_name != name and of_name in texts:
                high = texts.pop(name.replace(LOW_END, HIGH_END))
                ends = f"{texts.pop(name)} to {high}"
                texts[of_name] += f" (90 % interval {ends})"
        return [*lines, *(f"- {name}: {text}" for name, text in texts.items())]

    def report(self, data: Dataset, seed: int) -> Text:
        """Return a text on the model, its data, its fit and the data's caveats."""
        info = data.choice.info
        lines = [
            f"{self.name}, fitted to {data.name} ({info.kind}, {len(data)} samples), robot "
            f"{data.robot.name}, seed {seed}",
            *self.learned,
            *(f"- {line}" for line in (*info.caveats, self.note) if line),
            *(f"- {name}: {text}" for name, text in self._error_facts()),
        ]
        return Text("\n".join(lines))

    def _error_facts(self) -> Iterator[tuple[str, str]]:
        """Yield name and text of the mean error and of the intervals, as far as they are stored."""
        stored = getattr(self.fitted, "cross_validated_error_", None)
        text = "not computed; errors on new poses: `bench run`"
        if stored:
            of_gauge = self.data is not None and self.data[0].samples.directions.size
            text = (
                f"{MM * stored.mean:.3g} mm {'along the readings' if of_gauge else 'in 3-D'} "
                f"({stored.n_folds} folds; "
                f"{MM * stored.rms:.3g} mm RMS, 90 % within {MM * stored.quantile_90:.3g} mm)"
            )
        yield MEAN_ERROR, text
        errors = getattr(self.fitted, "left_out_errors_", None)
        if self.data is None or (errors is None and not offers(self.fitted, "predict_interval")):
            return
        try:
            half = self.predict_interval(self.data[0], coverage=DEFAULT_COVERAGE).half_width
            text = (
                f"{MM * half.mean():.3g} mm, length over x, y and z, mean of the training samples"
            )
        except ConfigError as reason:  # too few poses
            text = f"not known: {reason}"
        yield half_width_name(DEFAULT_COVERAGE), text

    def save(self, output: FilePath, *, cross_validate: bool = True) -> None:
        """Save a fitted model to a file for `load_model` and `bench predict`.

        An existing file is replaced. After `fit`, further fits compute the errors at left-out poses
        for intervals and `cross_validated_error`; the file stores these errors.

        The file of a plugin's model has the hash of the plugin's code. To read it, name the plugin.

        Args:
            output: file; an existing one is replaced.
            cross_validate: store the error at left-out poses, from one more fit for each fifth of
                the poses.

        Raises:
            NotFittedError: `fit` was not called.
            ModelError: the model's class is defined in a script, or its state cannot be stored.
            StoreError: the file cannot be written.
        """
        from stiff_models.io.model_file import save

        self.check_fitted()
        choice = self.choice
        if self.data is not None and not offers(self.fitted, "predict_interval"):
            self._keep_left_out_errors()
        if self.data is not None and cross_validate:
            self._keep_cross_validated_error()
        if self.data is not None:
            self.fitted.data_text_ = self.data_text
        is_plugin = choice.cls.__module__ != "__main__" and bool(code_of(choice.cls))
        save(self.fitted, Path(output), {choice.info.key: choice.params} if is_plugin else None)

    def _keep_left_out_errors(self) -> None:
        """Compute the errors for intervals; warn if that fails."""
        try:
            _ = self.left_out_errors
        except Exception as error:  # any error of a third-party model in its second fit
            self.fitted.left_out_errors_ = np.empty((0, len(AXES)))
            text = f"{self.name} is saved without intervals: {describe_error(error)}"
            warn(text, stacklevel=3)

    def _keep_cross_validated_error(self) -> None:
        """Compute the cross-validated error; warn if that fails."""
        try:
            _ = self.cross_validated_error
        except Exception as error:  # any error of a third-party model in another fit
            text = f"{self.name} is saved without a cross-validated error: {describe_error(error)}"
            warn(text, stacklevel=3)

    def view(self) -> Screen:
        """Return a screen with the model's data, accuracy and fitted parameters."""
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
            facts += self._error_facts()
        table, springs = Table("", [], []), getattr(self.fitted, "springs_", None)
        numbers = self.diagnostics
        if springs:
            table = _springs_table(springs)
            numbers = {name: x for name, x in numbers.items() if name not in springs.report()}
        shown_numbers = [*numbers.items()][:MOST_NUMBERS]
        facts += [(name, _number_text(name, value)) for name, value in shown_numbers]
        if len(numbers) > MOST_NUMBERS:
            facts.append(("more", f"{len(numbers) - MOST_NUMBERS} numbers in .diagnostics"))
        facts = [fact for fact in facts if fact[1]]
        headings = table.headings()
        return Screen(f"Model {self.name}, fitted", facts, headings, table.texts(), table.notes)


def model_choice(model: object, options: Mapping[str, Any]) -> Choice[ModelInfo]:
    """Return the model and options for a name, a class, an object of a class or a model.

    Raises:
        ConfigError: it is not a model, or an option is unknown or wrong.
    """
    if isinstance(model, Model):
        if options:
            raise ConfigError(f"{model.name} has its options; give its key with {[*options]}")
        choice = model.choice
    elif isinstance(model, str):
        choice = choice_of("model", model, options)
    else:
        is_class = isinstance(model, type)
        cls = model if isinstance(model, type) else type(model)
        options = dict(options) if is_class else {**_options_of_object(model), **options}
        if cls.__module__.startswith("sklearn."):
            from stiff_models.regressors.sklearn_model import key_of_class

            choice = choice_of("model", key_of_class(cls), options)
        else:
            choice = Choice(_line_of(cls), cls, options, {})
    check_model(choice)
    return choice


def _line_of(cls: type) -> ModelInfo:
    """Return the catalogue line of a class, which is named as its class unless it has one."""
    key = cls.__name__
    if (info := registry().models.get(key)) is not None and info.load() is cls:
        return info
    if key in registry().origins:
        raise ConfigError(f"{key!r} is the key of {registry().origins[key]}; rename the class")
    return ModelInfo(key=key, target=cls, summary="")


def _options_of_object(model: object) -> dict[str, Any]:
    """Return the options of an object of a model's class that differ from their defaults.

    Raises:
        ConfigError: it is not a model, or its options cannot be read from it.
    """
    name = type(model).__name__
    if not all(callable(getattr(model, method, None)) for method in ("fit", "predict")):
        raise ConfigError(
            f"{name} is not a model (valid: a name, a class with fit and predict, or its object)"
        )
    try:
        parameters = inspect.signature(type(model)).parameters
        if any(
            part.kind in (part.VAR_POSITIONAL, part.VAR_KEYWORD) for part in parameters.values()
        ):
            raise TypeError("its constructor takes *args or **kwargs")
        given = optional(model, "get_params")(deep=False)
        return {
            option: given[option]
            for option, part in parameters.items()
            if part.default is part.empty or bool(given[option] != part.default)
        }
    except (AttributeError, KeyError, TypeError, ValueError, RuntimeError) as error:
        raise ConfigError(
            f"the options of this {name} cannot be read ({describe_error(error)}); give the class: "
            f"make_model({name}, option=value), with numbers and texts as values"
        ) from error


def make_model(model: str | type | object, **options: Any) -> Model:
    """Return an unfitted model.

    Args:
        model: key, such as "ft-mlp" or "sklearn:ensemble.RandomForestRegressor", name with
            options, such as "ft-mlp@freeze=full", or your own class with the model interface, or
            an object of it or of scikit-learn, whose options it gets.
        options: options of the model; `bench show NAME` lists them.

    Raises:
        ConfigError: the name or an option is unknown, or a value is wrong.
    """
    return Model(model_choice(model, options))


def load_model(file: Path | str) -> Model:
    """Read a fitted model written by `Model.save` or `bench fit`.

    Raises:
        ConfigError: `file` is not a path.
        DataError: the file cannot be read or is corrupt; or it has a plugin's model, and
            `use_plugin` was not called or the plugin's code has changed.
    """
    from stiff_models.io.model_file import key_of, load

    file, plugin_registry = path_of(file), registry()
    plugins = {
        key: info.load()
        for key, info in plugin_registry.models.items()
        if plugin_registry.origins[key] != OURS
    }
    fitted = load(file, plugins)
    keys = [key for key, cls in plugins.items() if type(fitted) is cls]
    choice: Choice[ModelInfo] = Choice.of(
        plugin_registry.model(keys[0] if keys else key_of(fitted))
    )
    model = Model(choice if keys else replace(choice, params=fitted.get_params(deep=False)))
    model.fitted, model.file = fitted, file
    return model


@contextmanager
def wrap_model_errors(
    model_file: Path | None, but: tuple[()] | type[Exception] = ()
) -> Iterator[None]:
    """Convert any error of a model from a file to a DataError, except errors of type `but`."""
    try:
        yield
    except but:
        raise
    except Exception as error:
        if model_file is None:
            raise
        kind = "" if isinstance(error, StiffBenchError) else f"{type(error).__name__}: "
        raise DataError(f"{model_file}: its model cannot predict: {kind}{error}") from error


SPRING_INTERVAL = 0.9


def _number_text(name: str, value: float) -> str:
    """Return the text of a number in `diagnostics`."""
    is_missing = name.startswith(CONTRIBUTION) and not value
    return "none found" if is_missing else f"{value:.4g}"


def _springs_table(springs: IdentifiedSprings) -> Table:
    """Return the stiffness of each spring with its interval."""
    rows: list[list[Entry]] = []
    for name, unit, compliance, is_known, (low, high) in zip(
        springs.names,
        springs.units,
        springs.compliance.tolist(),
        springs.is_identified,
        springs.interval(SPRING_INTERVAL).tolist(),
        strict=True,
    ):
        stiffness = Quantity(1.0 / compliance) if compliance else Quantity(status="rigid")
        label = f"{name} [{unit}]" if is_known else f"{name} [{unit}], not identifiable: prior"
        rows.append([label, stiffness, Quantity(low=low, high=high)])
    return Table(
        "",
        [
            Column("spring", "text"),
            Column("stiffness", format=".4g"),
            Column(f"{percent(SPRING_INTERVAL)} interval", format=".4g"),
        ],
        rows,
        [
            f"rank {springs.rank}, condition number {springs.condition:.4g}",
            "The springs absorb what the model leaves out, such as tilting bearings. The intervals "
            "cover the noise of the samples, not the joints' own stiffness.",
        ],
    )
