#!/usr/bin/env bash
# Trains tests/data/two-models.tar.zst: three iterations of PPO and of a teacher, as COMMIT trains them.
#
#     scripts/make_old_model.sh [COMMIT]
#
# The libraries of the present environment are used; only our own code is the old one. The archive
# holds the bucket as that version left it, without graphs and logs. The archive of version 0.1.0 was made likewise.
set -euo pipefail
commit=${1:-98a294f1}
project=$(cd "$(dirname "$0")/.." && pwd)
python=$project/.venv/bin/python
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
git -C "$project" archive "$commit" | (mkdir "$work/code" && tar -x -C "$work/code")
export PYTHONPATH=$work/code:$work/code/env
# Only the first 4 units of each hidden layer begin with weights other than 0. The others never get a
# gradient, so they stay 0, and the archive has a tenth of its size.
cat >>"$work/code/drcli/learn/actor_critic.py" <<'PATCH'


def _narrow(self, spec):
    _build(self, spec)
    heads = [self.value_head, *([self.teacher.layers] if spec.taught else [])]
    with torch.no_grad():
        for layer in (*self.body.convolutions, *self.body.dense):
            if isinstance(layer, (nn.Linear, nn.Conv2d)):
                layer.weight[4:] = 0.0
        pixels = self.body.dense[0].weight[:4].view(4, -1, self.body.convolutions[-1].out_channels)
        pixels[..., 4:] = 0.0
        for head in (head for head in heads if isinstance(head, nn.Sequential)):
            for k in (0, 2):
                head[k].weight[4:] = 0.0
                head[k].bias[4:] = 0.0
                head[k + 2].weight[:, 4:] = 0.0


_build, ActorCritic.__init__ = ActorCritic.__init__, _narrow
PATCH

mkdir "$work/racer" && cd "$work/racer"
cp "$work/code/run.env" "$work/code/system.env" .
mkdir custom_files
cp "$work/code/defaults/"*.{py,json} custom_files/
parameters=custom_files/hyperparameters.json
sed -i 's/\("num_episodes_between_training"\): .*/\1: 2,/' $parameters

dr() { "$python" -c 'import sys; sys.argv[0] = "dr"; from drcli.cli.program import main; main()' "$@"; }
train() {
    sed -i "s/^DR_LOCAL_S3_MODEL_PREFIX=.*/DR_LOCAL_S3_MODEL_PREFIX=$1/" run.env
    DR_TRAIN_MAX_ITERATIONS=3 DR_TRAIN_MIN_EVAL_TRIALS=1 dr start-training --seed 1 </dev/null
}
train ppo
sed -i '1a "training_method": "teacher",' $parameters
train teacher
dr stop-all
tar -C data/s3/bucket --exclude='model_*.pb' --exclude=logs -c . |
    "$python" -c 'import sys, zstandard as z; z.ZstdCompressor(19).copy_stream(sys.stdin.buffer, sys.stdout.buffer)' \
        >"$project/tests/data/two-models.tar.zst"
ls -l "$project/tests/data/two-models.tar.zst"
