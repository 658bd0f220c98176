"""The glossary, also of docs/glossary.md."""

from collections.abc import Mapping

GLOSSARY: Mapping[str, str] = {
    "action": "What the car is asked to do in one step: a steering angle and a speed.",
    "action space": "All actions that a model can choose from: a list (discrete), or a range of "
    "steering angles and a range of speeds (continuous). It is in `model_metadata.json`.",
    "advantage": "How much better an action turned out than the critic had expected. PPO makes "
    "actions with a positive advantage more likely.",
    "agent": "The part that decides: the policy with its car.",
    "argmax": "Taking the most likely action. Evaluations and the physical car do this; a training "
    "draws actions by their probability instead.",
    "batch": "The same as a minibatch: the steps from which the weights are changed once. "
    "`batch_size` says how many.",
    "best checkpoint": "The checkpoint with the best evaluation so far, by "
    "`DR_TRAIN_BEST_MODEL_METRIC`.",
    "bucket": "The place where models, metrics and traces are stored, on this machine or at an S3 "
    "service. Its objects have keys that look like paths.",
    "calibration": "Telling the car which signal is straight ahead, full left, full right, "
    "stop, and "
    "full speed. It is done once on the car's web page.",
    "centre line": "The line in the middle of the road, given by the waypoints.",
    "checkpoint": "The weights of the network after an iteration, stored as files in the bucket.",
    "clean lap": "A lap that is completed without a reset and without a penalty. An evaluation "
    "episode of a training ends at the first violation, so if its lap is completed, it is clean.",
    "clipped PPO": "PPO: the algorithm `clipped_ppo`. It limits how much one iteration may change "
    "the policy, which keeps learning stable.",
    "clone": "A new model that starts with the weights of another one (`dr-increment-training`).",
    "collapse": "A sudden loss of what was learned: the reward falls and does not recover.",
    "convergence": "The curves level off: more training hardly changes the model any more. A model "
    "has converged well when training and evaluation both complete their laps.",
    "critic": "The part of the network that predicts how much reward will still come. The policy "
    "is judged by its predictions; the car does not need it.",
    "data point": "One step as the learner sees it: camera picture, action, reward, next picture. "
    "Also called experience.",
    "discount": "How much less a reward counts for each step that it comes later "
    "(`discount_factor`).",
    "distillation": "The second phase of a training with a teacher: a student with a camera learns "
    "to do what the teacher would do, wherever the student drives (DAgger). See "
    "`training_method`.",
    "domain randomisation": "Varying light, grip, delay and more while training, so that the model "
    "also works where the world is a little different, such as on the real track.",
    "entropy": "How undecided the policy is. High: it acts at random. Low: it is sure. It should "
    "fall slowly while a model trains.",
    "environment": "Everything around the agent: track, car, camera, reward function. Here it is "
    "the simulation.",
    "episode": "One drive, from the start until the lap is complete, the car leaves the road or "
    "crashes, or time runs out.",
    "epoch": "One pass over all steps of an iteration (`num_epochs`).",
    "evaluation": "Driving without learning and without exploring, to see what a checkpoint can "
    "do.",
    "experience buffer": "The steps that were driven and not yet learned from: for PPO those of "
    "one "
    "iteration, for SAC the replay buffer.",
    "exploration": "Trying actions that do not look best, to find better ones.",
    "fence": "The check that a process still owns its model before it writes to the bucket.",
    "finished lap": "A lap that is completed, perhaps after resets, as the reference counts it. "
    "Its time has the penalties: 12.80 s = 7.80 driven + 5.00 penalty.",
    "frame": "One camera picture, 160 x 120 grey pixels.",
    "frozen graph": "The policy as one file that can only drive (`model.pb`). The physical car "
    "reads "
    "this form.",
    "generalisation": "How well a model drives where it was not trained: on another track, in "
    "other "
    "light, with less grip.",
    "gradient": "The direction in which a change of the weights helps most.",
    "horizon": "How many steps ahead the car plans: about 1 / (1 - discount_factor).",
    "hyperparameter": "A number that says how to learn, not what: learning rate, batch size and so "
    "on. They are in `hyperparameters.json`.",
    "iteration": "Driving `num_episodes_between_training` episodes with one checkpoint, and "
    "learning "
    "the next checkpoint from them.",
    "KL divergence": "How much the policy has changed. A large value warns that an update went too "
    "far.",
    "latency": "The time from the camera picture to the movement of the wheels.",
    "lease": "A note in the bucket that says which machine trains a model. It expires a minute "
    "after "
    "that machine is gone.",
    "local optimum": "A habit that is better than everything close to it, but not good: the car is "
    "stuck with it.",
    "loss": "What the learner makes smaller: how wrong the critic is, and how little the policy "
    "does of what worked.",
    "metadata": "`model_metadata.json`: actions, sensors, network and algorithm of a model.",
    "minibatch": "The steps from which the weights are changed once (`batch_size`).",
    "model": "Everything below one prefix in the bucket: checkpoints, the racer's files, "
    "metrics and "
    "traces.",
    "NaN": "Not a number: a calculation went wrong, for example because the learning rate is too "
    "high. Weights with NaN cannot drive.",
    "neural network": "The function with millions of weights that turns a camera picture into the "
    "probabilities of actions.",
    "off track": "No wheel is on the road; the episode ends.",
    "optimizer": "The part of the trainer that changes the weights; here Adam. It has a memory, "
    "which is stored with the checkpoint.",
    "over-fitting": "Learning the training track by heart, with its background and its light, "
    "instead of how to drive.",
    "policy": "The function that chooses actions: the part of the network that drives.",
    "PPO": "Proximal policy optimization, the algorithm `clipped_ppo`: stable, and the default.",
    "prefix": "The name of a model in the bucket, such as `team/model-3`.",
    "progress": "How much of the lap is done, in percent.",
    "racing line": "The path round the track that allows the fastest lap.",
    "real-time factor": "Simulated time divided by real time. drcli simulates fixed steps, so lap "
    "times do not depend on it.",
    "replay buffer": "The last steps that SAC learns from, again and again.",
    "return": "The sum of all rewards of an episode from a step on, later ones discounted.",
    "reward": "The number that the reward function returns for a step.",
    "reward function": "Your function that says how good a step was. It is only needed to train; "
    "the physical car does not use it.",
    "reward shaping": "Writing a reward function that leads to the goal in small steps, instead of "
    "paying only at the end.",
    "rollout": "The recorded episodes of an iteration.",
    "SAC": "Soft actor-critic, the algorithm `sac`: for continuous actions only. It needs fewer "
    "steps and reacts more to its hyperparameters than PPO.",
    "seed": "A number that decides everything random. Equal seeds give equal trainings.",
    "sim-to-real gap": "The difference between simulation and reality, because of which a model "
    "that "
    "is perfect here may fail on the car.",
    "simulation worker": "A process that drives cars in the simulation and records their steps.",
    "step": "One decision of the car, 15 of them per simulated second.",
    "student": "The camera policy while it learns from a teacher.",
    "supervisor": "The process that starts the workers of a training, watches them and ends them.",
    "teacher": "A policy that sees the track instead of the camera: where the car is, and how the "
    "road goes on. It learns within a minute, drives only in the simulation, and shows a student "
    "what to do (`training_method`, docs/teacher.md).",
    "throttle": "How much power the motor gets. The physical car turns the speed of an action "
    "into a "
    "throttle; it does not measure speed.",
    "trace": "A table of every step that was driven (simtrace), for analysis.",
    "trainer": "The process that learns from the recorded steps and writes checkpoints.",
    "training data": "All steps that a model has learned from.",
    "value": "What the critic predicts: the rewards that will still come.",
    "waypoint": "A point on the centre line. A track has a list of them, in driving direction.",
    "weights": "The numbers inside the network. Learning changes them.",
    "worker": "A process of a training: a simulation worker or the trainer.",
    "zigzag": "A curve that jumps up and down, or a car that swings from side to side. Lower `lr` "
    "against the first; pay for less steering, or less for time on the road, against the second.",
}
