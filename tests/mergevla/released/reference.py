"""The released networks from their formulae, on released tensors: nothing of ours, and of transformers Qwen2 alone."""

import torch
from torch.nn import functional
from transformers import Qwen2Config, Qwen2Model


def linear(w, name, x):
    return functional.linear(x, w[f"{name}.weight"], w.get(f"{name}.bias"))


def norm(w, name, x, eps=1e-5):
    return functional.layer_norm(x, x.shape[-1:], w[f"{name}.weight"], w[f"{name}.bias"], eps)


def heads_of(x, heads):
    return x.view(*x.shape[:2], heads, -1).transpose(1, 2)


def tower(w, name, pixels, size):
    """Features of the patches after the last block but one (timm's `get_intermediate_layers`), (B, patches, width)."""
    x = functional.conv2d(
        pixels, w[f"{name}.patch_embed.proj.weight"], w[f"{name}.patch_embed.proj.bias"], size.patch_size
    )
    x = x.flatten(2).transpose(1, 2) + w[f"{name}.pos_embed"]
    before = [
        w[f"{name}.{token}"].expand(len(x), -1, -1) for token in ("cls_token", "reg_token") if f"{name}.{token}" in w
    ]
    x = torch.cat([*before, x], dim=1)
    for i in range(size.layers - 1):
        block = f"{name}.blocks.{i}"
        q, k, v = linear(w, f"{block}.attn.qkv", norm(w, f"{block}.norm1", x, 1e-6)).chunk(3, dim=-1)
        q, k, v = (heads_of(one, size.heads) for one in (q, k, v))
        seen = torch.softmax(q @ k.mT / q.shape[-1] ** 0.5, dim=-1) @ v
        x = x + w.get(f"{block}.ls1.scale_factor", 1.0) * linear(
            w, f"{block}.attn.proj", seen.transpose(1, 2).flatten(2)
        )
        hidden = functional.gelu(linear(w, f"{block}.mlp.fc1", norm(w, f"{block}.norm2", x, 1e-6)))
        x = x + w.get(f"{block}.ls2.scale_factor", 1.0) * linear(w, f"{block}.mlp.fc2", hidden)
    return x[:, sum(one.shape[1] for one in before) :]


def hidden_states(w, a, images, ids):
    """(h_T, h_A), each (B, layers + 1, tokens, width): prompts without padding, (B, T)."""
    frames = images.flatten(0, 1)
    mean, std = torch.tensor([0.485, 0.456, 0.406]), torch.tensor([0.229, 0.224, 0.225])
    dinov2 = tower(
        w, "vision_backbone.featurizer", (frames - mean[:, None, None]) / std[:, None, None], a.vision.dinov2
    )
    siglip = tower(w, "vision_backbone.fused_featurizer", (frames - 0.5) / 0.5, a.vision.siglip)
    x = torch.cat([dinov2, siglip], dim=-1).unflatten(0, images.shape[:2]).flatten(1, 2)
    for layer in ("fc1", "fc2"):
        x = functional.gelu(linear(w, f"projector.{layer}", x))
    patches = linear(w, "projector.fc3", x)
    words = w["language_model.model.embed_tokens.weight"][ids]
    queries = w["action_queries.weight"].expand(len(ids), -1, -1)
    sequence = torch.cat([words[:, :1], patches, words[:, 1:], queries], dim=1)
    states = torch.stack(qwen(w, a)(inputs_embeds=sequence, output_hidden_states=True).hidden_states, dim=1)
    count, last = patches.shape[1], sequence.shape[1] - 1
    return states[:, :, :count], states[:, :, last - queries.shape[1] : last]


def qwen(w, a):
    """The language model."""
    llm = a.language
    model = Qwen2Model(
        Qwen2Config(
            vocab_size=llm.vocabulary,
            hidden_size=llm.width,
            intermediate_size=llm.feed_forward,
            num_hidden_layers=llm.layers,
            num_attention_heads=llm.heads,
            num_key_value_heads=llm.key_value_heads,
            rope_parameters={"rope_type": "default", "rope_theta": 1e6},
            attn_implementation="eager",
        )
    )
    prefix = "language_model.model."
    model.load_state_dict({n.removeprefix(prefix): t for n, t in w.items() if n.startswith(prefix)})
    return model.eval()


def rope(x):
    """Angles half-split, pairs of neighbours: x (B, heads, n, dim)."""
    count, dim = x.shape[-2:]
    angles = torch.arange(count)[:, None] * 10000.0 ** (-torch.arange(0, dim, 2) / dim)
    angles = torch.cat([angles, angles], dim=-1)
    turned = torch.empty_like(x)
    turned[..., 0::2], turned[..., 1::2] = -x[..., 1::2], x[..., 0::2]
    return x * angles.cos() + turned * angles.sin()


def block(w, name, x, h_t, h_a, p, heads, *, pro):
    """One block, x (B, chunk, width): softmax over adapter, gated task and, in VLA-Adapter-Pro, own keys."""
    conditions = torch.cat([h_a, p[:, None]], dim=1)

    def projected(layer, states):
        return heads_of(linear(w, f"{name}.{layer}", states), heads)

    query = rope(projected("q_proj" if pro else "q_proj_adapter", x))
    task_query = query if pro else rope(projected("q_proj_task", x))
    g = w[f"{name}.gating_factor"]
    gate = torch.tanh(g) if pro else 1 / (1 + torch.exp(-g))
    logits = [
        query @ rope(projected("k_adapter", conditions)).mT,
        task_query @ rope(projected("k_task", h_t)).mT * gate,
    ]
    values = [projected("v_adapter", conditions), projected("v_task", h_t)]
    if pro:
        logits.insert(0, query @ rope(projected("k_self", x)).mT)
        values.insert(0, projected("v_self", x))
    weights = torch.softmax(torch.cat(logits, dim=-1) / query.shape[-1] ** 0.5, dim=-1)
    attended = (weights @ torch.cat(values, dim=2)).transpose(1, 2).flatten(2)
    x = norm(w, f"{name}.ffn.0", x + linear(w, f"{name}.o_proj", attended))
    return functional.relu(linear(w, f"{name}.ffn.1", x))


def chunk(w, a, h_t, h_a, proprioception, *, pro):
    """The normalised action chunk (B, 8, 7), from hidden states and normalised proprioception (B, 8)."""
    p = linear(w, "fc2", functional.gelu(linear(w, "fc1", proprioception)))
    x = norm(w, "model.layer_norm1", torch.zeros(len(p), a.chunk_length, a.action_dim * a.width))
    x = functional.relu(linear(w, "model.fc1", x))
    for i in range(a.language.layers):
        name = f"model.mlp_resnet_blocks.{i}"
        x = block(w, name, x, h_t[:, i + 1], h_a[:, i + 1], p, a.expert.heads, pro=pro)
    return linear(w, "model.fc2", norm(w, "model.layer_norm2", x))
