"""A run or a step as a function of PyTorch, on the CPU, with its derivatives backwards (extra `torch`)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from phfmu.doors.function import Differentiable, restricted


def torch_function(of: Differentiable, free: Sequence[str] | None = None) -> Callable[..., Any]:
    """A function of tensors, one for each block of arguments, to a tensor, or a tuple of them for several results.

    free:  the arguments that it has, in their order; others are what the model declares (default: it has all)
    Tensors are of 64 bits, on the CPU; `backward` and `torch.autograd.grad` go through it, second derivatives do not.
    Errors: ImportError without PyTorch; TypeError for tensors of another kind; KeyError for an argument that there is not.
    """
    try:
        import torch  # pyright: ignore[reportMissingImports]
    except ImportError as error:
        raise ImportError('torch_function needs PyTorch: pip install "phfmu[torch]"') from error
    own = restricted(of, free)

    class TorchFunction(torch.autograd.Function):
        """values and reverse of `own`."""

        @staticmethod
        def forward(ctx: Any, *arguments: Any) -> Any:
            ctx.save_for_backward(*arguments)
            return tuple(torch.from_numpy(v) for v in own.values(*(a.detach().numpy() for a in arguments)))

        @staticmethod
        @torch.autograd.function.once_differentiable
        def backward(ctx: Any, *bars: Any) -> Any:
            found = own.reverse([a.detach().numpy() for a in ctx.saved_tensors], [b.numpy() for b in bars])
            given = zip(found, ctx.saved_tensors, strict=True)
            return tuple(torch.from_numpy(v.copy()).reshape(a.shape) for v, a in given)

    def function(*arguments: Any) -> Any:
        for block, a in zip(own.inputs, arguments, strict=True):
            if not isinstance(a, torch.Tensor) or a.dtype != torch.float64 or a.device.type != "cpu":
                kind = f"{a.dtype} on {a.device}" if isinstance(a, torch.Tensor) else type(a).__name__
                raise TypeError(f"{own.name}: {block.name} is {kind}; expected a tensor of torch.float64 on the CPU")
        found = TorchFunction.apply(*arguments)
        return found[0] if len(own.outputs) == 1 else found

    return function
