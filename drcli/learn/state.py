"""The optimizer's memory as named tensors, so that it can be stored without pickling."""

import torch
from torch import Tensor


def optimizer_tensors(optimizer: torch.optim.Optimizer) -> dict[str, Tensor]:
    """Everything an optimizer remembers about its parameters.

    Returns:
        Tensors by "<index of the parameter>.<name>"; empty before the first step.
    """
    return {
        f"{index}.{name}": torch.as_tensor(value).detach().contiguous()
        for index, memory in optimizer.state_dict()["state"].items()
        for name, value in memory.items()
    }


def restore_optimizer(optimizer: torch.optim.Optimizer, tensors: dict[str, Tensor]) -> None:
    """Give an optimizer the memory of another one over equal parameters; the tensors are copied.

    Each comes to lie in memory as its parameter does: the fused optimizer goes through both
    without a look at their strides, and stored tensors have lost theirs.
    """
    parameters = [p for group in optimizer.param_groups for p in group["params"]]
    state: dict[int, dict[str, Tensor]] = {}
    for key, value in tensors.items():
        index, name = key.split(".", 1)
        own = value if value.dim() == 0 else torch.empty_like(parameters[int(index)])
        state.setdefault(int(index), {})[name] = own.copy_(value) if value.dim() else value.clone()
    groups = optimizer.state_dict()["param_groups"]
    optimizer.load_state_dict({"state": state, "param_groups": groups})
