"""Learns in three phases: a teacher that sees the track, its student with a camera, and PPO.

The teacher learns within seconds, because no picture is drawn. The student imitates it on roads
that it drives itself (Ross et al., 2011, "DAgger"; Chen et al., 2019, "Learning by cheating").
What is best for somebody who sees less differs: hence PPO.
"""

from collections.abc import Callable
from dataclasses import replace

import torch
from torch import Tensor
from torch.nn import functional

from drcli.learn.actor_critic import FIRST_LOG_STD, ActorCritic, Teacher
from drcli.learn.adam import Adam
from drcli.learn.algorithms import PPOConfig
from drcli.learn.compute import Compute
from drcli.learn.data_parallel import DataParallel
from drcli.learn.learner import Learner
from drcli.learn.phases import FINE_LR, FINE_LR_OF_CHOICES, Phase
from drcli.learn.policy import Float32s, Observation
from drcli.learn.ppo import PPO
from drcli.learn.replay_buffer import ReplayBuffer
from drcli.learn.rollout_buffer import Rollout
from drcli.learn.update_result import (
    DistillationStats,
    Stats,
    require_finite_losses,
    require_finite_weights,
)

TEACHER = PPOConfig(
    batch_size=512,
    num_epochs=8,
    lr=1e-3,
    beta_entropy=5e-4,
    gae_lambda=0.9,
    max_grad_norm=0.5,
    lr_schedule="linear",
    smoothness=0.5,
    bootstrap_cut=True,
)
"""Of the model's hyperparameters only the discount factor counts here.

Without smoothness, a teacher weaves. On `reinvent_base` a student then drove 37 of 40 laps clean,
in 5.5 s; with 0.25 to 1, all, in 5.4 s (one seed each, 150,000 steps of the teacher, 15,000 of the
student).
"""

STUDENT = PPOConfig(batch_size=64, lr=1e-3, lr_schedule="linear", schedule_steps=50_000)
REMEMBERED_STEPS = 40_000
"""0.8 GB of frames."""

NEWEST_STEPS = 8_192
"""Half of what it learns from is of these."""

PASSES = 3
CRITIC_WARMUP = 3
"""The critic has only seen a teacher drive."""

REPORTS = 4
SMALL_LOG_STD = -2.3
"""Enough to show what to do beside the line; cars stay on the road."""

FINE_LOG_STD = -1.6
FINE_KL = 0.03
LARGEST_LABEL = 1.2
"""Beyond 1, means say how sure the teacher is, but would move a student's other actions."""


class TaughtLearner(Learner):
    """Hands on to the learner of the present phase."""

    model: ActorCritic
    config: PPOConfig

    def __init__(self, model: ActorCritic, config: PPOConfig, compute: Compute) -> None:
        super().__init__(model, config, compute)
        self.teacher = Teacher(model)
        self.phase: Phase = "teacher"
        self._learner: Learner
        self.begin("teacher")

    def begin(self, phase: Phase) -> None:
        """Go on with a phase and a fresh optimizer."""
        self.phase = phase
        self.model.teacher.requires_grad_(phase == "teacher")
        if phase == "teacher":
            if self.model.spec.continuous:  # a teacher that comes from elsewhere has to try again
                with torch.no_grad():
                    self.model.teacher.log_std.fill_(FIRST_LOG_STD)
            small = replace(self.compute, bf16=False, parts=1)
            own = replace(TEACHER, discount_factor=self.config.discount_factor)
            self._learner = PPO(self.teacher, own, small)
        elif phase == "distillation":
            self._calm(SMALL_LOG_STD)
            self._learner = Distillation(self.model, self._labels, self.compute)
        else:
            self._calm(FINE_LOG_STD)
            most = FINE_LR if self.model.spec.continuous else FINE_LR_OF_CHOICES
            lr, target_kl = min(self.config.lr, most), self.config.target_kl or FINE_KL
            fine = replace(self.config, lr=lr, target_kl=target_kl)
            self._learner = PPO(self.model, fine, self.compute)
            self._learner.critic_warmup = CRITIC_WARMUP
        self.optimizer, self.memory_steps = self._learner.optimizer, self._learner.memory_steps

    def _calm(self, log_std: float) -> None:
        if self.model.spec.continuous:
            with torch.no_grad():
                self.model.log_std.fill_(log_std)
                self.model.teacher.log_std.fill_(log_std)

    @property
    def critic_warmup(self) -> int:
        return self._learner.critic_warmup

    @critic_warmup.setter
    def critic_warmup(self, updates: int) -> None:
        self._learner.critic_warmup = updates

    @property
    def capture_failure(self) -> str | None:
        return self._learner.capture_failure

    @property
    def most_samples(self) -> int | None:
        return self._learner.most_samples

    def remember(self, rollout: Rollout) -> None:
        self._learner.remember(rollout)

    def update(
        self,
        rollout: Rollout,
        seed: int,
        on_epoch: Callable[[Stats], None] = lambda stats: None,
        should_stop: Callable[[], bool] = lambda: False,
        steps_before: int = 0,
    ) -> list[Stats]:
        """See `Learner.update`; `steps_before` are those of this phase."""
        self._learner.lr_factor = self.lr_factor
        threads = torch.get_num_threads()
        if self.phase == "teacher":  # its operations are shorter than to wake a thread
            torch.set_num_threads(1)
        try:
            return [*self._learner.update(rollout, seed, on_epoch, should_stop, steps_before)]
        finally:
            torch.set_num_threads(threads)

    def _labels(self, rollout: Rollout) -> Float32s:
        self.teacher.train()  # one product for all steps, which gives equal rollouts equal bits
        state = torch.from_numpy(rollout.states).to(self.compute.device)
        with torch.inference_mode():
            policy = self.teacher.policy(state)
            if not self.model.spec.continuous:
                policy = policy.softmax(-1)
        return policy.cpu().numpy()


Labels = Callable[[Rollout], Float32s]
"""What a teacher would do in each step: probabilities, or actions. Shape (t, num_actions)."""


class Distillation(Learner):
    """Imitates a teacher wherever one of them has driven."""

    memory_steps = REMEMBERED_STEPS
    capture_failure = None

    def __init__(self, student: ActorCritic, labels: Labels, compute: Compute) -> None:
        super().__init__(student, STUDENT, compute)
        self._student, self._labels = student, labels
        self.optimizer = Adam([*student.body.parameters(), *student.policy_head.parameters()], 0.0)
        self._parallel = DataParallel(
            student, compute.parts, compute.threads, bf16=compute.bf16, num_statistics=1
        )
        self._driven = ReplayBuffer(student.spec, REMEMBERED_STEPS)

    def remember(self, rollout: Rollout) -> None:
        if rollout.frames.size:  # nothing was drawn for a teacher
            labels = self._labels(rollout)
            if self._student.spec.continuous:
                labels = labels.clip(-LARGEST_LABEL, LARGEST_LABEL)
            self._driven.add(replace(rollout, actions=labels))

    def update(
        self,
        rollout: Rollout,
        seed: int,
        on_epoch: Callable[[DistillationStats], None] = lambda stats: None,
        should_stop: Callable[[], bool] = lambda: False,
        steps_before: int = 0,
    ) -> list[DistillationStats]:
        self.remember(rollout)
        draw = torch.Generator().manual_seed(seed)
        self.optimizer.lr = self.lr_factor * STUDENT.lr_at(steps_before)
        self._student.train()
        total = max(REPORTS, PASSES * rollout.steps // STUDENT.batch_size)
        history = []
        with self._parallel.optimizer_threads():
            for part in range(REPORTS):
                count = total * (part + 1) // REPORTS - total * part // REPORTS
                losses = []
                for _ in range(count):
                    losses.append(self._take_step(draw))
                    if should_stop():
                        break
                loss = float(torch.cat(losses).mean())
                require_finite_losses({"imitation": loss})
                history.append(DistillationStats(part, self.optimizer.lr, loss))
                on_epoch(history[-1])
                if len(losses) < count:
                    break
        require_finite_weights(self._student)
        return history

    def _take_step(self, draw: torch.Generator) -> Tensor:
        seen, wanted = self._driven.sample_observed(STUDENT.batch_size, draw, NEWEST_STEPS)
        device = self.compute.device
        seen, wanted = Observation(*(column.to(device) for column in seen)), wanted.to(device)

        def loss_of(student: ActorCritic, part: slice) -> tuple[Tensor, Tensor]:
            policy = student(seen.part(part)).policy
            if student.spec.continuous:
                loss = functional.huber_loss(policy, wanted[part])
            else:
                loss = functional.kl_div(
                    policy.log_softmax(-1), wanted[part], reduction="batchmean"
                )
            return loss, loss.detach().reshape(1)

        self.optimizer.zero_grad()
        statistics = self._parallel.backward(loss_of, len(wanted))
        self.optimizer.step()
        return statistics
