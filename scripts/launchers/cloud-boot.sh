#!/bin/bash
# Start-up script for a machine of Google Cloud (metadata key startup-script) or Azure (custom data):
# installs drcli once, and trains from every boot on as a systemd service. Fill in the
# first lines. On Amazon, `dr-spot create` does all of this.
#
# Google Cloud gives 30 seconds before it takes a spot machine away, so TimeoutStopSec is shorter.
set -euo pipefail

DRCLI=${DRCLI:-https://example.com/drcli-0.1.0-py3-none-any.whl}
ENDPOINT=${ENDPOINT:-https://storage.googleapis.com} # any S3 address
BUCKET=${BUCKET:-my-bucket}
MODEL=${MODEL:-my-model}
WORLD=${WORLD:-reinvent_base}
ROOT=${ROOT:-} # of the file system, for tests

home=$ROOT/srv/racing
unit=$ROOT/etc/systemd/system/dr-training.service

if [ ! -x "$ROOT/opt/drcli/bin/dr-start-training" ]; then
    apt-get update -q
    apt-get install -qy python3-venv
    id racer >/dev/null 2>&1 || useradd --system --create-home --home-dir "$home" racer
    python3 -m venv "$ROOT/opt/drcli"
    "$ROOT/opt/drcli/bin/pip" install --quiet torch==2.13.0 \
        --index-url https://download.pytorch.org/whl/cpu
    "$ROOT/opt/drcli/bin/pip" install --quiet "$DRCLI"
fi

mkdir -p "$home" "$(dirname "$unit")"
if [ ! -e "$home/run.env" ]; then
    printf '%s\n' "DR_LOCAL_S3_MODEL_PREFIX=$MODEL" "DR_WORLD_NAME=$WORLD" >"$home/run.env"
    printf '%s\n' DR_CLOUD=remote "DR_REMOTE_MINIO_URL=$ENDPOINT" "DR_LOCAL_S3_BUCKET=$BUCKET" \
        >"$home/system.env"
    chown -R racer: "$home"
fi

# Keys of the bucket, if it wants some, go into /etc/drcli-keys.env (chmod 600) and not in here:
# every program on the machine can read this script.
cat >"$unit" <<UNIT
[Unit]
Description=DeepRacer training in $home
Wants=network-online.target
After=network-online.target
StartLimitIntervalSec=0

[Service]
Type=exec
User=racer
WorkingDirectory=$home
EnvironmentFile=-$ROOT/etc/drcli-keys.env
ExecStart=$ROOT/opt/drcli/bin/dr-start-training --resume-or-start --foreground
SuccessExitStatus=75 143
RestartForceExitStatus=75
Restart=on-abnormal
RestartSec=15
KillMode=mixed
TimeoutStopSec=28
NoNewPrivileges=yes

[Install]
WantedBy=multi-user.target
UNIT
systemctl daemon-reload
systemctl enable --now dr-training.service
