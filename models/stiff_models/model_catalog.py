"""The model families that stiffbench ships, and why an optional family cannot be used here.

Imports nothing heavy, so that lists appear at once.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import combinations
from pathlib import Path
from typing import Literal, get_args

from stiff_protocols.contract.errors import unknown_name
from stiff_protocols.contract.extras import missing
from stiff_protocols.contract.plugin import Citation, ModelFamily, ModelInfo

SpringModel = Literal[
    "vjm",
    "vjm-multisegment",
    "vjm-full",
    "fourier-springs",
    "curve-springs",
    "bayes-springs",
]
"""Keys of the spring models, which other families build on."""

_QUICK_NETWORK = {"width": 16, "epochs": 20}
_QUICK_PROCESS = {"restarts": 0, "ard": False}
_LAYERS = ("1", "2", "3", "4", "out")  # of the base network, as `freeze=layers:` names them
_KERNELS = {"kernel": ("matern", "rbf"), "ard": (True, False)}
_PHYSICS = {"physics": get_args(SpringModel)}
_QUICK_SOURCE = {"width": 16, "pretrain_steps": 20}

REFERENCE_MODEL = "vjm"
"""Reference of every other model's skill."""


def _citation(authors: Sequence[str], year: int, title: str, url: str = "") -> Citation:
    return Citation(authors=authors, year=year, title=title, url=url)


_STIFFBENCH = _citation(["stiffbench"], 2026, "A model of stiffbench, docs/models.md")
_SOURCE_PAPER = _citation(
    ["Kai Wu", "Yuanhui Zhang", "Dehua Gao", "Shuhan Deng", "Weihua Li", "Mingfeng Wang"],
    2024,
    "Neural network-based transfer learning to improve stiffness modeling of industrial robots "
    "with small experimental data sets",
    "https://doi.org/10.1007/s00170-024-14794-z",
)
_GAUSSIAN_PROCESSES = _citation(
    ["Carl Edward Rasmussen", "Christopher K. I. Williams"],
    2006,
    "Gaussian Processes for Machine Learning",
    "https://gaussianprocess.org/gpml",
)

MODELS = (
    ModelInfo(
        key="zero",
        target="stiff_models.regressors.regressor_model:ZeroModel",
        summary="no deflection: the uncorrected path",
        equation="d = 0",
    ),
    ModelInfo(
        key="mean",
        target="stiff_models.regressors.regressor_model:MeanModel",
        summary="mean deflection of the training samples",
        equation="d = mean of the training deflections",
    ),
    ModelInfo(
        key="knn",
        target="stiff_models.regressors.regressor_model:NearestNeighbours",
        summary="mean of the nearest training samples",
        equation="d = weighted mean of the nearest training deflections",
        citation=_citation(
            ["Thomas M. Cover", "Peter E. Hart"],
            1967,
            "Nearest neighbor pattern classification",
            "https://doi.org/10.1109/TIT.1967.1053964",
        ),
        grids={"default": {"neighbours": (1, 3, 5, 10), "weights": ("uniform", "distance")}},
    ),
    ModelInfo(
        key="vjm",
        target="stiff_models.physics.vjm:VirtualJointModel",
        version=2,
        summary="virtual joint model, one linear spring per joint, least squares",
        equation="d = J_v diag(c) J^T w, c >= 0",
        reference="deflection = J K^-1 J^T wrench; identified as in the source paper",
        kind="physics",
        citation=_citation(
            ["J. Kenneth Salisbury"],
            1980,
            "Active stiffness control of a manipulator in Cartesian coordinates",
            "https://doi.org/10.1109/CDC.1980.272026",
        ),
    ),
    ModelInfo(
        key="vjm-multisegment",
        target="stiff_models.physics.multi_segment_vjm:MultiSegmentVjm",
        version=2,
        summary="VJM with piecewise linear joint springs, preloaded by gravity",
        equation="d = J_v [phi(tau_g + J^T w) - phi(tau_g)], phi piecewise linear",
        reference="multi-segment joint stiffness after Schneider et al.; see docs/models.md",
        kind="physics",
        citation=_STIFFBENCH,
        grids={"default": {"segments": (2, 3), "breakpoints": ("quantile", "search")}},
    ),
    ModelInfo(
        key="vjm-full",
        target="stiff_models.physics.full_vjm:FullVjm",
        version=2,
        summary="VJM with three or six springs per joint, a prior for those not identifiable",
        equation="d = sum over 18 or 36 springs s of J_v,s c_s J_s^T w, c_s >= 0",
        reference="after Pashkevich, Klimchik and Chablat 2011",
        kind="physics",
        citation=_citation(
            ["Anatol Pashkevich", "Alexandr Klimchik", "Damien Chablat"],
            2011,
            "Enhanced stiffness modeling of manipulators with passive joints",
            "https://doi.org/10.1016/j.mechmachtheory.2010.12.008",
        ),
        grids={"default": {"springs": (3, 6), "solver": ("nnls", "ridge")}},
    ),
    ModelInfo(
        key="fourier-springs",
        target="stiff_models.physics.fourier_springs:FourierSprings",
        summary="VJM whose compliances depend on the angles of shoulder and elbow, by ridge",
        equation="d = J_v diag(c(q2, q3)) J^T w, c a Fourier series, c >= 0",
        reference="after arXiv 2510.19962, 2025; docs/models.md",
        kind="physics",
        citation=_citation([], 2025, "arXiv 2510.19962", "https://arxiv.org/abs/2510.19962"),
    ),
    ModelInfo(
        key="curve-springs",
        target="stiff_models.physics.curve_springs:CurveSprings",
        summary="18 virtual springs, the joints' own with three slopes and lost motion, by ridge",
        equation="d = sum over springs s of a_s [phi_s(tau_g + tau) - phi_s(tau_g)], phi_s with "
        "few parameters",
        reference="the yardstick for models that learn a curve; docs/models.md",
        kind="physics",
        citation=_STIFFBENCH,
        grids={"default": {"weights": ("equal", "student")}},
    ),
    ModelInfo(
        key="bayes-springs",
        target="stiff_models.regressors.bayes_springs:BayesSprings",
        summary="springs, lost motion, links, base and errors of the rig, scales by likelihood",
        equation="d = sum over groups of F_g(q, w) b_g, b_g ~ N(0, s_g^2), s_g by marginal "
        "likelihood",
        reference="MacKay 1992, evidence framework; groups in docs/models.md",
        kind="physics",
        citation=_STIFFBENCH,
    ),
    ModelInfo(
        key="mlp",
        target="stiff_models.networks.mlp:Mlp",
        version=2,
        summary="4 x 380 network from scratch on the measured training samples",
        equation="d = net(sin q, cos q, w)",
        reference="network of the source paper, without its transfer",
        kind="network",
        citation=_SOURCE_PAPER,
        uses_validation=True,
        quick=_QUICK_NETWORK,
        grids={"default": {"learning_rate": (3e-4, 1e-3, 3e-3), "width": (128, 380)}},
    ),
    ModelInfo(
        key="mlp-pretrained",
        target="stiff_models.transfer.pretrained_mlp:MlpPretrained",
        version=4,
        summary="4 x 380 network trained only on simulated samples",
        equation="d = net(sin q, cos q, w), trained on a simulated VJM",
        reference="pre-training of the source paper",
        kind="hybrid",
        citation=_SOURCE_PAPER,
        quick=_QUICK_SOURCE,
    ),
    ModelInfo(
        key="ft-mlp",
        target="stiff_models.transfer.ft_mlp:FtMlp",
        version=5,
        summary="pre-trained network, fine-tuned on what the best of three VJMs leaves",
        equation="d = teacher(q, w) + net_theta(q, w) - net_theta0(q, w), theta0 pre-trained",
        reference="the method of the source paper with anchor=none, or with its preset",
        kind="hybrid",
        citation=_SOURCE_PAPER,
        uses_validation=True,
        quick=_QUICK_SOURCE | {"epochs": 10},
        grids={
            "default": {"freeze": ("layers:1,2", "full", "head", "last:2", "lp-ft")},
            "freeze-single": {"freeze": tuple(f"layers:{layer}" for layer in _LAYERS)},
            "freeze-pairs": {
                "freeze": tuple(f"layers:{','.join(pair)}" for pair in combinations(_LAYERS, 2))
            },
            "rate": {"learning_rate": (1e-4, 3e-4, 1e-3, 3e-3)},
        },
    ),
    ModelInfo(
        key="dt-cnn",
        target="stiff_models.transfer.dt_cnn:DtCnn",
        version=3,
        summary="1x1-convolution network pre-trained on simulated samples; alignment on request",
        equation="d = net(sin q, cos q, w) of 1x1 convolutions, trained on a simulated VJM",
        reference="Zhao et al., UDTL, 2021; the source paper's DT-CNN",
        kind="hybrid",
        citation=_SOURCE_PAPER,
        quick={"pretrain_steps": 12},
        grids={"default": {"alignment": ("none", "mk-mmd", "coral")}},
    ),
    ModelInfo(
        key="adann-2r",
        target="stiff_models.transfer.adann:Adann2R",
        version=3,
        summary="4 x 380 network with two regressors, adversarially adapted to the measured poses",
        equation="d = mean of two regressors on one feature network, adversarially adapted",
        reference="after Saito et al. 2018 and Xia et al. 2022",
        kind="hybrid",
        citation=_citation(
            ["Kuniaki Saito", "Kohei Watanabe", "Yoshitaka Ushiku", "Tatsuya Harada"],
            2018,
            "Maximum classifier discrepancy for unsupervised domain adaptation",
            "https://doi.org/10.1109/CVPR.2018.00392",
        ),
        quick=_QUICK_SOURCE,
        grids={"default": {"adversarial_weight": (0.0, 0.1, 0.3, 1.0)}},
    ),
    ModelInfo(
        key="compliance-net",
        target="stiff_models.transfer.compliance_net:ComplianceNet",
        version=4,
        summary="network of pose-dependent joint compliances in the VJM's equation",
        equation="d = J_v diag(c(q, tau)) J^T w, c = softplus(net)",
        kind="hybrid",
        citation=_STIFFBENCH,
        uses_validation=True,
        quick=_QUICK_NETWORK,
    ),
    ModelInfo(
        key="deep-ensemble",
        target="stiff_models.transfer.deep_ensemble:DeepEnsemble",
        version=8,
        summary="mean of several ft-mlp with different seeds",
        equation="d = mean of five ft-mlp with other seeds",
        reference="Lakshminarayanan, Pritzel and Blundell 2017",
        kind="hybrid",
        citation=_citation(
            ["Balaji Lakshminarayanan", "Alexander Pritzel", "Charles Blundell"],
            2017,
            "Simple and scalable predictive uncertainty estimation using deep ensembles",
            "https://arxiv.org/abs/1612.01474",
        ),
        uses_validation=True,
        quick=_QUICK_SOURCE | {"epochs": 10, "members": 2},
    ),
    ModelInfo(
        key="residual-mlp",
        target="stiff_models.networks.mlp:ResidualMlp",
        version=3,
        summary="VJM plus an MLP of its residual",
        equation="d = physics(q, w) + net(sin q, cos q, w)",
        kind="hybrid",
        citation=_STIFFBENCH,
        uses_validation=True,
        quick=_QUICK_NETWORK,
        grids={
            "default": {"learning_rate": (3e-4, 1e-3, 3e-3), "width": (128, 380)},
            "physics": _PHYSICS,
        },
    ),
    ModelInfo(
        key="gp",
        target="stiff_models.regressors.gp_model:GaussianProcessModel",
        version=4,
        summary="Gaussian process of the deflection, with prediction intervals",
        equation="d ~ GP(sin q, cos q, w)",
        kind="Gaussian process",
        citation=_GAUSSIAN_PROCESSES,
        quick=_QUICK_PROCESS,
        grids={"default": _KERNELS},
    ),
    ModelInfo(
        key="vjm-gp",
        target="stiff_models.regressors.gp_model:VjmGp",
        version=4,
        summary="VJM plus a Gaussian process of its residual, with prediction intervals",
        equation="d = physics(q, w) + GP(sin q, cos q, w)",
        kind="hybrid",
        citation=_GAUSSIAN_PROCESSES,
        quick=_QUICK_PROCESS,
        grids={"default": _KERNELS, "physics": _PHYSICS},
    ),
    ModelInfo(
        key="vjm-boosting",
        target="stiff_models.regressors.regressor_model:VjmBoosting",
        version=2,
        summary="VJM plus gradient-boosted trees of its residual",
        equation="d = physics(q, w) + boosted trees(sin q, cos q, w)",
        kind="hybrid",
        citation=_citation(
            ["Jerome H. Friedman"],
            2001,
            "Greedy function approximation: a gradient boosting machine",
            "https://doi.org/10.1214/aos/1013203451",
        ),
        quick={"trees": 20},
        grids={
            "default": {"learning_rate": (0.02, 0.05, 0.1), "leaves": (4, 8)},
            "physics": _PHYSICS,
        },
    ),
    ModelInfo(
        key="realmlp",
        target="stiff_models.regressors.tabular:RealMlp",
        summary="RealMLP, a tuned network for small tables",
        equation="d = RealMLP(sin q, cos q, w)",
        reference="Holzmueller, Grinsztajn and Steinwart 2024; package pytabkit",
        kind="network",
        missing_because="stiff_models.model_catalog:missing_pytabkit",
        library="pytabkit",
        uses_validation=True,
        quick={"epochs": 3},
    ),
    ModelInfo(
        key="tabm",
        target="stiff_models.regressors.tabular:TabM",
        summary="TabM, an ensemble of networks that share most weights",
        equation="d = TabM(sin q, cos q, w)",
        reference="Gorishniy, Kotelnikov and Babenko 2025; package pytabkit",
        kind="network",
        missing_because="stiff_models.model_catalog:missing_pytabkit",
        library="pytabkit",
        uses_validation=True,
        quick={"epochs": 3},
    ),
    ModelInfo(
        key="tabpfn",
        target="stiff_models.regressors.tabular:TabPfn",
        summary="TabPFN, a network that learned to predict from small tables",
        equation="d = TabPFN(sin q, cos q, w)",
        reference="Hollmann et al. 2025; package tabpfn",
        kind="network",
        missing_because="stiff_models.model_catalog:missing_tabpfn",
        library="tabpfn",
    ),
    ModelInfo(
        key="tabicl",
        target="stiff_models.regressors.tabular:TabIcl",
        summary="TabICL, an open network that learned to predict from small tables",
        equation="d = TabICL(sin q, cos q, w)",
        reference="Qu, Holzmueller, Varoquaux and Le Morvan 2026 (TabICLv2); package tabicl",
        kind="network",
        missing_because="stiff_models.model_catalog:missing_tabicl",
        library="tabicl",
    ),
)

FAMILIES = (
    ModelFamily(
        prefix="sklearn:",
        target="stiff_models.regressors.sklearn_model:member",
        example="sklearn:ensemble.RandomForestRegressor",
        summary="any scikit-learn regressor, on encoded and standardised features",
    ),
    ModelFamily(
        prefix="vjm+sklearn:",
        target="stiff_models.regressors.sklearn_model:member",
        example="vjm+sklearn:ensemble.RandomForestRegressor",
        summary="VJM plus any scikit-learn regressor of its residual",
    ),
)


def model_info(key: str) -> ModelInfo:
    """Return the entry of a shipped model or of a family's member; ConfigError if unknown."""
    for info in MODELS:
        if info.key == key:
            return info
    for family in FAMILIES:
        if key.startswith(family.prefix):
            return family.member(key)
    raise unknown_name("model", key, [info.key for info in MODELS])


def is_spring_model(name: str) -> bool:
    """Return True for a spring model with any options, such as `vjm-full@tcp=fit`."""
    return name.partition("@")[0] in get_args(SpringModel)


def missing_pytabkit() -> str:
    """Return why `realmlp` and `tabm` cannot be used here; "" if they can."""
    return missing("pytabkit")


def missing_tabpfn(model_path: str = "") -> str:
    """Return why `tabpfn` cannot be used here: no package, or no weights; "" if it can.

    `model_path` is the file of weights; "": the package's default in its own cache folder.
    """
    return missing("tabpfn") or _missing_weights("tabpfn", model_path, _tabpfn_weights)


def missing_tabicl(model_path: str = "") -> str:
    """Return why `tabicl` cannot be used here: no package, or no weights; "" if it can.

    `model_path` is the file of weights; "": the package's default in Hugging Face's cache folder.
    """
    return missing("tabicl") or _missing_weights("tabicl", model_path, _tabicl_weights)


def _missing_weights(key: str, model_path: str, default: Callable[[], Path]) -> str:
    file = Path(model_path) if model_path else default()
    if file.is_file():
        return ""
    return (
        f"the weights file {file} does not exist (nothing is downloaded at run time): "
        f"set {key}.model_path to a weights file of the package's regressor"
    )


def _tabpfn_weights() -> Path:
    from tabpfn.model_loading import resolve_model_path, resolve_model_version

    version = resolve_model_version(None)
    (path,), *_ = resolve_model_path(None, "regressor", version.value)
    return Path(path)


def _tabicl_weights() -> Path:
    from huggingface_hub import try_to_load_from_cache
    from tabicl import TabICLRegressor

    name = TabICLRegressor().checkpoint_version
    cached_file = try_to_load_from_cache("jingang/TabICL", name)  # a path, or a reason
    return Path(cached_file if isinstance(cached_file, str) else name)
