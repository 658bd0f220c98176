"""What each hyperparameter does, also for docs/hyperparameters.md."""

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class HyperparameterText:
    """Texts about one key; `advice`: where to begin."""

    meaning: str
    higher: str = ""
    lower: str = ""
    advice: str = ""


HYPERPARAMETER_TEXTS: Mapping[str, HyperparameterText] = {
    "batch_size": HyperparameterText(
        "Steps in a minibatch. The weights change once for each minibatch.",
        "Stabler: each change is a mean over more steps. Slower: there are fewer changes in an "
        "iteration.",
        "Faster at first, but noisier.",
        "Begin with 64. If the reward zigzags, try 128 before you lower lr.",
    ),
    "beta_entropy": HyperparameterText(
        "Bonus for varied actions (entropy).",
        "Explores longer and escapes bad habits, but the car stays restless and converges later. "
        "Much too high, it drives at random.",
        "Converges earlier, but may settle on a habit that is only fairly good. With 0, it often "
        "settles too early.",
        "Begin with 0.01. Lower it to 0.001 when laps are complete and you want them fast.",
    ),
    "discount_factor": HyperparameterText(
        "Weight of a reward that comes one step later. With a factor g, the car plans about "
        "1 / (1 - g) steps ahead; 15 steps are one second.",
        "Plans further ahead, which rewards at the finish need. Learning gets harder, because more "
        "future steps add their chance to each estimate.",
        "Learns faster and more stably, but does not see what comes later. Much too low, the car "
        "takes a good moment now for a crash in two seconds.",
        "The shipped 0.95 plans 20 steps (1.3 s) ahead, enough for rewards at each step. Take 0.99 "
        "or 0.999 for rewards that come late.",
    ),
    "e_greedy_value": HyperparameterText(
        "Only for exploration_type e-greedy: the share of random actions in the end.",
        "Explores more for ever; training episodes end earlier.",
        "Drives almost as in an evaluation, and learns little that is new.",
        "0.05, and only if you chose e-greedy.",
    ),
    "epsilon_steps": HyperparameterText(
        "Only for exploration_type e-greedy: the number of steps in which the share of random "
        "actions falls from 1 to e_greedy_value.",
        "Explores for longer before the car drives as it has learned.",
        "Trusts the policy earlier, perhaps before it has seen the whole track.",
        "10000.",
    ),
    "exploration_type": HyperparameterText(
        "How the car chooses actions while it trains.",
        "categorical draws each action from the policy's probabilities. e-greedy (discrete "
        "actions) "
        "takes a random action with a share that falls, otherwise the most likely one. "
        "additive_noise belongs to SAC.",
        "",
        "categorical for clipped_ppo, additive_noise for sac.",
    ),
    "loss_type": HyperparameterText(
        "The critic's loss, in the critic's own units.",
        "huber gives less weight to large errors: stabler, for example with a large bonus at the "
        "finish. 'mean squared error' follows large errors at once: faster when rewards are even, "
        "less stable when they are not.",
        "",
        "huber.",
    ),
    "lr": HyperparameterText(
        "Learning rate: how far each change of the weights goes.",
        "Converges faster, but the reward may zigzag or collapse. The largest allowed value is "
        "0.001.",
        "Stabler, but slow; much too low, the car never gets anywhere.",
        "The shipped 0.001 reaches the first lap soonest. Divide it by three when the reward "
        "zigzags or falls, or let it fall by itself with lr_schedule.",
    ),
    "num_episodes_between_training": HyperparameterText(
        "Episodes in an iteration, of all workers together. The policy is updated after them.",
        "Stabler: each update knows more of the track. Slower: there are fewer updates.",
        "Reacts fast, and zigzags. Below 5, an update sees too little of the track.",
        "20; 40 with several workers, or when the curve zigzags.",
    ),
    "num_epochs": HyperparameterText(
        "Passes over the steps of an iteration.",
        "Learns more from the same steps, but takes more computing and may overfit to them: watch "
        "the KL divergence in the log.",
        "Stabler and cheaper, but learns less from each step.",
        "3. Try 10 if driving is the slow part, not learning.",
    ),
    "stack_size": HyperparameterText(
        "Frames that the network sees at once. The reference ignores this key.",
        "Shows motion, of bots for example. Each step computes more, and the physical car does not "
        "support it: a model with more than one frame cannot be exported for the car.",
        "1 is enough for a road without other cars.",
        "1.",
    ),
    "term_cond_avg_score": HyperparameterText(
        "Mean score at which a training should end. The reference ignores it, and so does drcli.",
        advice="Use DR_TRAIN_STOP_MEAN_SCORE.",
    ),
    "term_cond_max_episodes": HyperparameterText(
        "Iterations after which the training ends. Despite its name it counts iterations, not "
        "episodes, as in the reference.",
        advice="Leave it at 100000, and use DR_TRAIN_MAX_MINUTES or --until-laps.",
    ),
    "sac_alpha": HyperparameterText(
        "Only for sac: the temperature, which says how much reward one nat of entropy is worth. "
        "With sac_auto_alpha it is the first value, in the critics' own units.",
        "Explores longer, and converges later.",
        "Settles earlier, perhaps too early.",
        "Set sac_auto_alpha and write 0.1; the training adapts it.",
    ),
    "clip_range": HyperparameterText(
        "How far one iteration may change the probability of an action before it gains nothing "
        "more by it (PPO's epsilon).",
        "Larger updates: faster, less stable.",
        "Smaller, safer updates: stabler, slower.",
        "0.2.",
    ),
    "gae_lambda": HyperparameterText(
        "How much an advantage trusts the rewards that followed, and how much the critic.",
        "Trusts the rewards: right on average, but noisy. 1 trusts only them.",
        "Trusts the critic: smooth, but wrong as long as the critic is. 0 trusts only the critic.",
        "0.95.",
    ),
    "clip_value": HyperparameterText(
        "How far a value prediction may move in an iteration before its loss is clipped; 5 is the "
        "mean size of the returns. Off if left out.",
        "The critic learns faster.",
        "The critic moves more steadily.",
        "Leave it out.",
    ),
    "clip_advantage": HyperparameterText(
        "Largest advantage after it was normalised, so that one lucky step does not count for "
        "more. Off if left out.",
        "Lucky steps count for more.",
        "Stabler, but rare successes count for less.",
        "Leave it out; try 3 if one event throws the training off.",
    ),
    "target_kl": HyperparameterText(
        "An update ends early, after the first epoch in which the policy has changed by more than "
        "this (KL divergence). Off if left out.",
        "Larger updates: faster, less stable.",
        "Smaller updates: stabler, slower.",
        "0.02 is common when num_epochs is high.",
    ),
    "max_grad_norm": HyperparameterText(
        "Largest norm of a gradient. Off if left out.",
        "Large errors change more at once.",
        "Stabler: helps against a late collapse and against NaN.",
        "0.5 is common.",
    ),
    "lr_schedule": HyperparameterText(
        "Whether lr stays (constant) or falls to a twentieth over schedule_steps (linear).",
        "linear converges fast at first and stably later.",
        "",
        "linear for long trainings; set schedule_steps to the steps that you plan.",
    ),
    "entropy_schedule": HyperparameterText(
        "Whether beta_entropy stays (constant) or falls to a twentieth over schedule_steps "
        "(linear).",
        "linear explores first and drives precisely later.",
        "",
        "linear for long trainings.",
    ),
    "schedule_steps": HyperparameterText(
        "Length of both schedules, in environment steps.",
        "The values fall more slowly.",
        "The values fall sooner; afterwards the model hardly changes any more.",
        "About as many steps as the training will take.",
    ),
    "critic": HyperparameterText(
        "What the critic sees: the camera picture (camera), or offset, speed, the road ahead and "
        "objects (state). The policy never sees the state.",
        "state gives better estimates, but then only the policy's gradient trains the layers that "
        "read the camera.",
        "",
        "camera for PPO.",
    ),
    "training_method": HyperparameterText(
        "How a training begins: with the camera alone (camera), or with a teacher that sees the "
        "track (teacher). The teacher learns to drive first, then a student with a camera learns "
        "from it, then PPO goes on. Only for clipped_ppo; docs/teacher.md tells more.",
        "teacher learns fast laps much sooner. The learning curve is another one than the "
        "console's: "
        "the camera policy has learned nothing until its phase begins.",
        "",
        "camera if you want to compare with the console, or study PPO; teacher if you want a fast "
        "model soon.",
    ),
    "bootstrap_cut": HyperparameterText(
        "Whether the critic's estimate is added to the return of an episode that the step limit "
        "cut off.",
        "true does not punish a car for a lap that takes too long.",
        "",
        "false.",
    ),
    "sac_auto_alpha": HyperparameterText(
        "Only for sac: learns the temperature sac_alpha while it trains.",
        "true needs no search for the right sac_alpha.",
        "",
        "true.",
    ),
    "sac_tau": HyperparameterText(
        "Only for sac: how fast the target critics follow the critics.",
        "Faster, less stable.",
        "Stabler, slower.",
        "0.02.",
    ),
    "sac_n_step": HyperparameterText(
        "Only for sac: rewards that a critic's target counts before it trusts a critic.",
        "Rewards travel back faster along the lap, but depend on older policies.",
        "1 is as in the reference: exact, but slow.",
        "5.",
    ),
    "sac_updates_per_step": HyperparameterText(
        "Only for sac: gradient steps for each step driven.",
        "Learns more from each step, but takes more computing and is less stable.",
        "Cheaper, slower.",
        "0.5 on a processor, 1 on a GPU.",
    ),
    "sac_replay_steps": HyperparameterText(
        "Only for sac: steps that the replay buffer holds; each frame takes 19.2 kB of memory.",
        "Stabler: it does not forget how bad driving looked.",
        "Less memory; follows the present policy more closely.",
        "100000.",
    ),
    "sac_learning_starts": HyperparameterText(
        "Only for sac: steps driven at random before the first gradient step.",
        "The critics begin with more variety.",
        "Learning starts sooner, from less.",
        "1000.",
    ),
}
"""A key that this version does not read is not shown."""
