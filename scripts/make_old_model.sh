#!/usr/bin/env bash
# Trains tests/data/trained-with-0.1.0.tar.zst: one iteration with the code of version 0.1.0.
#
#     scripts/make_old_model.sh [COMMIT]
#
# COMMIT is the version that trains. The libraries of the present environment are used; only our own
# code is the old one. The archive holds the whole bucket, as that version left it.
set -euo pipefail
commit=${1:-41b7227}
project=$(cd "$(dirname "$0")/.." && pwd)
python=$project/.venv/bin/python
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
git -C "$project" archive "$commit" | (mkdir "$work/code" && tar -x -C "$work/code")
export PYTHONPATH=$work/code:$work/code/env
# Only 16 of the 256 units of the dense layer begin with weights other than 0. The others never get a
# gradient, so they stay 0, and the archive has a tenth of its size.
python_patch='
import pathlib, sys
path = pathlib.Path(sys.argv[1])
text = path.read_text()
last = "                nn.init.zeros_(parameter)\n"
assert text.count(last) == 1
path.write_text(text.replace(last, last + "        self.dense[0].weight.data[16:] = 0.0\n"))
'
"$python" -c "$python_patch" "$work/code/drcli/learn/encoders.py"

mkdir "$work/racer" && cd "$work/racer"
cp "$work/code/run.env" "$work/code/system.env" .
mkdir custom_files
cp "$work/code/defaults/"*.{py,json} custom_files/
sed -i 's/^DR_LOCAL_S3_MODEL_PREFIX=.*/DR_LOCAL_S3_MODEL_PREFIX=model/' run.env
sed -i 's/\("num_episodes_between_training"\): .*/\1: 4,/; s/\("term_cond_max_episodes"\): .*/\1: 4/' \
    custom_files/hyperparameters.json

dr() { "$python" -c 'import sys; sys.argv[0] = "dr"; from drcli.program import main; main()' "$@"; }
dr start-training --seed 1 </dev/null
dr stop-all
tar -C data/s3/bucket -c custom_files model runs |
    "$python" -c 'import sys, zstandard as z; z.ZstdCompressor(19).copy_stream(sys.stdin.buffer, sys.stdout.buffer)' \
        >"$project/tests/data/trained-with-0.1.0.tar.zst"
ls -l "$project/tests/data/trained-with-0.1.0.tar.zst"
