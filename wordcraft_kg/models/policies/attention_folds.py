"""Out-of-sample attention: a network for each fold of the train recipes, which never learns from tasks of this fold.

Attention remembers train tasks. If mixing weights learned on the same tasks, they would trust this memory, as they
would trust a scorer that has seen the recipes. So a state of a train task either teaches the networks that may learn
from the task, with constant mixing weights, or the mixing weights, with the networks that never learn from the task.
"""

import numpy as np
import torch
from torch import Tensor, nn

from wordcraft_kg.base.errors import GraphMismatchError, LeakError
from wordcraft_kg.graphs.folds import folds_of_tasks
from wordcraft_kg.graphs.tasks import TaskSet


class AttentionFolds(nn.Module):
    """Chooses among K attention networks for each state; the chosen networks have equal shares.

    Network k never learns from a task with a recipe in fold k. Other networks may, and all are new to a test task.

    Attributes:
        count: K.
        fold_of_recipe: buffer, each recipe's fold, shape (num_recipes,), int64;
            :data:`~wordcraft_kg.graphs.folds.OUTSIDE` outside train.
        model_of_task: buffers are not saved from here on. For each of N tasks and then for unlisted tasks, shape
            (N + 1, 2, K), float32: shares of networks that never learn from the task, and of networks that may.
        bound_to: hash of the N tasks.
    """

    fold_of_recipe: Tensor
    model_of_task: Tensor
    reads_task = True

    def __init__(self, fold_of_recipe: Tensor):
        super().__init__()
        self.count, self.bound_to = int(fold_of_recipe.max()) + 1, ""
        self.register_buffer("fold_of_recipe", fold_of_recipe)
        self.register_buffer("model_of_task", torch.zeros(0, 2, self.count), persistent=False)

    def bind(self, tasks: TaskSet) -> None:
        """Set the task set that task numbers in later calls index.

        GraphMismatchError if the tasks belong to another graph or split.
        """
        if tasks.hash == self.bound_to:
            return
        if len(self.fold_of_recipe) != tasks.graph.num_recipes:
            raise GraphMismatchError(
                f"the policy has folds for {len(self.fold_of_recipe):,} recipes but '{tasks.graph.name}' has "
                f"{tasks.graph.num_recipes:,}. Use the policy on the graph of its training."
            )
        is_left_out = np.pad(folds_of_tasks(self.fold_of_recipe.cpu().numpy(), tasks), ((0, 1), (0, 0)))
        # To tasks without a train recipe all networks are new, and if no network may learn, none has a share.
        chosen = np.stack([is_left_out | ~is_left_out.any(1, keepdims=True), ~is_left_out], axis=1)
        shares = chosen / np.maximum(chosen.sum(2, keepdims=True), 1)
        self.model_of_task = torch.from_numpy(shares.astype(np.float32)).to(self.fold_of_recipe.device)
        self.bound_to = tasks.hash

    def forward(self, task: Tensor, table: Tensor, *, is_learning: bool) -> tuple[Tensor, Tensor | None]:
        """Return each network's share for each state, shape (B, K).

        Without learning, only networks that never learn from the task have one. With learning, the sum of the table's
        ids decides whether a state teaches networks or mixing weights: always the same for the same state, and both for
        each task, with different distractors. This decision is the second result, shape (B,), bool, True for the mixing
        weights; None without learning.

        ``task``, shape (B,), holds task numbers, N for unlisted tasks; ``table`` has shape (B, A). LeakError if
        :meth:`bind` was never called.
        """
        if not self.bound_to:
            raise LeakError(
                "the policy has an attention network per fold and needs the tasks to choose networks that never "
                "learned from a task: call `bind` first, for example with `world.tasks`."
            )
        new, learning = self.model_of_task.index_select(0, task).unbind(1)
        if not is_learning:
            return new, None
        for_lambdas = (table.sum(1) % 2 == 0) | (learning.sum(1) == 0)
        return torch.where(for_lambdas[:, None], new, learning), for_lambdas
