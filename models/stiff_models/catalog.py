"""The model families that stiffbench ships."""

from __future__ import annotations

from stiff_protocols.plugin import ModelInfo

MODELS = (
    ModelInfo(
        key="vjm",
        target="stiff_models.vjm:VirtualJointModel",
        summary="linear virtual joint model, one torsion spring a joint, least squares",
        reference="deflection = J K^-1 J^T wrench; identified as in the source paper",
    ),
    ModelInfo(
        key="mlp",
        target="stiff_models.mlp:Mlp",
        summary="4 x 380 network from scratch on the measured training samples",
        reference="network of the source paper, without its transfer",
        uses_validation=True,
    ),
    ModelInfo(
        key="mlp-pretrained",
        target="stiff_models.mlp_pretrained:MlpPretrained",
        summary="4 x 380 network trained on the simulated source domain alone",
        reference="pre-training of the source paper",
    ),
    ModelInfo(
        key="ft-mlp",
        target="stiff_models.ft_mlp:FtMlp",
        summary="pre-trained on the source domain, fine-tuned on the measurements",
        reference="the method of the source paper",
        uses_validation=True,
    ),
)
