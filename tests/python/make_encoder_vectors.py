"""Make tests/vectors/encoder_vectors.json: what published implementations of the paper's encoders compute.

  make_encoder_vectors.py           write the vectors
  make_encoder_vectors.py --check   recompute and compare with the committed file; exit 1 if it differs

The references are torchvision's resnet18 with a first convolution of one channel and a last layer of 128, and
transformers' ViTMAE and AST with the paper's sizes, the latter with patches of 16x1. Weights and inputs are no file:
both sides compute them from a tensor's name and a number's place (`value`). Needs PyTorch, which is large, and is
therefore not part of the test command:

  pip install torch==2.15.0 torchvision transformers==4.57.6
"""

import json
import pathlib
import re
import sys

import numpy as np
import torch
import torchvision
import transformers
from transformers import ASTConfig, ASTModel, ViTMAEConfig, ViTMAEForPreTraining

PATH = pathlib.Path(__file__).resolve().parents[1] / "vectors" / "encoder_vectors.json"
EPSILON = 1e-6
FRAMES = 60
TOLERANCE = 1e-5


def value(name, count):
    """Numbers from -1 to 1: FNV-1a of the name, then splitmix64 of the place."""
    seed = 0xCBF29CE484222325
    for byte in name.encode():
        seed = ((seed ^ byte) * 0x100000001B3) % 2**64
    with np.errstate(over="ignore"):
        z = np.uint64(seed) + np.arange(1, count + 1, dtype=np.uint64) * np.uint64(0x9E3779B97F4A7C15)
        z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return (((z ^ (z >> np.uint64(31))) >> np.uint64(40)).astype(np.float64) / 2**23 - 1).astype(np.float32)


def numbers(name, shape):
    """A parameter of the trainer's name and shape."""
    part, drawn = name.rsplit(".", 1)[-1], value(name, int(np.prod(shape))).reshape(shape)
    if part == "weight":
        inputs = shape[0] if len(shape) == 2 else int(np.prod(shape[1:]))
        return drawn * np.float32(np.sqrt(np.float32(3 / inputs)))
    if part == "running_var":
        return 1 + np.float32(0.5) * drawn
    return (1 if part == "gamma" else 0) + np.float32(0.1) * drawn


def resnet_name(name):
    name = re.sub(r"layer(\d)\.(\d)\.", lambda m: f"blocks.{2 * int(m[1]) - 2 + int(m[2])}.", name)
    name = name.replace("downsample.0", "downsample.conv").replace("downsample.1", "downsample.bn")
    if re.search(r"bn\d?\.", name):
        name = name.replace(".weight", ".gamma").replace(".bias", ".beta")
    return name


def transformer_name(name):
    for theirs, ours in (
        ("attention.attention.", "mha."), ("attention.output.dense", "mha.output"),
        ("intermediate.dense", "pwff.linear_inner"), ("output.dense", "pwff.linear_outer"),
        ("layernorm_before.weight", "norm_2.gamma"), ("layernorm_before.bias", "norm_2.beta"),
        ("layernorm_after.weight", "norm_1.gamma"), ("layernorm_after.bias", "norm_1.beta"),
        ("encoder.layer.", "encoder.layers."), ("layernorm.weight", "norm.gamma"), ("layernorm.bias", "norm.beta"),
        ("embeddings.patch_embeddings.projection", "patch"), ("embeddings.cls_token", "class_token"),
        ("decoder.decoder_layers.", "decoder.layers."), ("decoder.decoder_norm.weight", "norm.gamma"),
        ("decoder.decoder_norm.bias", "norm.beta"), ("decoder.decoder_embed", "embed"),
        ("decoder.decoder_pred", "pixels"), ("decoder.mask_token", "mask_token"),
    ):
        name = name.replace(theirs, ours)
    return name


def fill(model, rename):
    """Fill all parameters but those that are not trained; how many numbers are."""
    count = 0
    named = [*model.named_parameters(), *((n, b) for n, b in model.named_buffers() if "running" in n)]
    for name, tensor in named:
        if "position_embeddings" in name or "decoder_pos_embed" in name:
            continue
        ours = rename(name)
        is_patch = ours.endswith("patch.weight")
        if is_patch:
            shape = (int(np.prod(tensor.shape[1:])), tensor.shape[0])
        else:
            shape = tuple(tensor.shape)[::-1] if tensor.dim() == 2 else tuple(tensor.shape)
        made = numbers(ours, shape)
        made = made.T if tensor.dim() == 2 or is_patch else made
        tensor.data = torch.from_numpy(np.ascontiguousarray(made).reshape(tuple(tensor.shape)))
        count += tensor.numel() if isinstance(tensor, torch.nn.Parameter) and tensor.requires_grad else 0
    return count


def scans(count):
    return torch.from_numpy(value("scans", count * 1024).reshape(count, 1, 32, 32))


def resnet():
    model = torchvision.models.resnet18(weights=None, num_classes=128)
    model.conv1 = torch.nn.Conv2d(1, 64, 7, stride=2, padding=3, bias=False)
    return {"parameters": fill(model.eval(), resnet_name), "embedding": model(scans(2)).tolist()}


def vit_mae():
    config = ViTMAEConfig(
        hidden_size=128, num_hidden_layers=8, num_attention_heads=8, intermediate_size=512, image_size=32,
        patch_size=4, num_channels=1, decoder_hidden_size=64, decoder_num_hidden_layers=4,
        decoder_num_attention_heads=4, decoder_intermediate_size=256, mask_ratio=0.75, layer_norm_eps=EPSILON,
        attn_implementation="eager")
    model = ViTMAEForPreTraining(config).eval()
    # This version leaves the decoder's positions at 0 where it should fill them.
    model.decoder.initialize_weights(64)
    count = fill(model, transformer_name)
    noise = torch.from_numpy(value("noise", 128).reshape(2, 64))
    out = model(scans(2), noise=noise)
    model.config.mask_ratio = 0.0
    model.vit.embeddings.config.mask_ratio = 0.0
    shown = torch.arange(64.0).repeat(2, 1)
    hidden = model.vit(scans(2), noise=shown).last_hidden_state
    return {
        "parameters": count,
        "encoder_parameters": sum(p.numel() for n, p in model.vit.named_parameters() if p.requires_grad),
        "order": torch.argsort(noise, dim=1).tolist(),
        "loss": out.loss.item(),
        "patches": {str(at): out.logits[:, at].tolist() for at in (0, 37, 63)},
        "embedding": hidden[:, 0].tolist(),
    }


def ast():
    config = ASTConfig(
        hidden_size=192, num_hidden_layers=12, num_attention_heads=3, intermediate_size=768, num_mel_bins=16,
        max_length=FRAMES, patch_size=16, layer_norm_eps=EPSILON, attn_implementation="eager")
    model = ASTModel(config).eval()
    embeddings = model.embeddings
    embeddings.patch_embeddings.projection = torch.nn.Conv2d(1, 192, (16, 1), stride=(16, 1))
    # Extra tokens and positions are one tensor each in the trainer.
    tokens = torch.from_numpy(numbers("tokens", (1, 2, 192)))
    positions = torch.from_numpy(numbers("positions", (1, FRAMES + 2, 192)))
    count = fill(model, transformer_name)
    embeddings.cls_token.data, embeddings.distillation_token.data = tokens[:, :1], tokens[:, 1:]
    embeddings.position_embeddings = torch.nn.Parameter(positions)
    frames = torch.from_numpy(value("frames", FRAMES * 16).reshape(1, FRAMES, 16))
    hidden = model(frames).last_hidden_state
    return {
        "parameters": count + positions.numel(),
        "hidden": {str(at): hidden[0, at].tolist() for at in (0, 2, 31, 61)},
    }


def flat(tree):
    if isinstance(tree, dict):
        return [number for key in tree for number in flat(tree[key])]
    return [number for part in tree for number in flat(part)] if isinstance(tree, list) else [tree]


def main():
    with torch.no_grad():
        made = {"resnet18": resnet(), "vit_mae": vit_mae(), "ssast": ast()}
    if "--check" in sys.argv:
        committed = json.loads(PATH.read_text())
        worst = 0.0
        for name, expected in made.items():
            ours, theirs = flat(committed[name]), flat(expected)
            worst = max(worst, np.inf if len(ours) != len(theirs) else np.abs(np.subtract(ours, theirs)).max())
        print(f"{PATH.name}: off by {worst:.1e} at most (allowed: {TOLERANCE:.0e})")
        sys.exit(0 if worst <= TOLERANCE else 1)
    origin = {
        "script": "tests/python/make_encoder_vectors.py",
        **{module.__name__: module.__version__ for module in (torch, torchvision, transformers)},
    }
    rounded = json.loads(json.dumps(made), parse_float=lambda text: round(float(text), 6))
    lines = [json.dumps({key: part})[1:-1] for key, part in {"origin": origin, **rounded}.items()]
    PATH.write_text("{" + ",\n".join(lines) + "}\n")
    print(f"{PATH.name}: {PATH.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
