#!/usr/bin/env bash
# Makes drcli/web/pages/vendor/preact/preact.js: Preact, htm and signals in one module, from the packages
# of npm, unchanged but bundled and minified. A test knows the hash of what comes out.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

out=$PWD/drcli/web/pages/vendor/preact
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
cd "$work"
npm install --silent --no-audit --no-fund --ignore-scripts --prefix "$work" \
    preact@11.2.0 htm@3.1.1 @preact/signals@2.11.4 @preact/signals-core@1.14.5 esbuild@0.28.2
cat >entry.js <<'MODULE'
export { Component, Fragment, createContext, render } from "preact";
export { useContext, useEffect, useId, useLayoutEffect, useMemo, useRef, useState } from "preact/hooks";
export { html } from "htm/preact";
export { batch, computed, effect, signal, untracked, useComputed, useSignal, useSignalEffect } from "@preact/signals";
MODULE
node_modules/.bin/esbuild entry.js --bundle --format=esm --minify --legal-comments=none --outfile="$out/preact.js"
for name in preact htm @preact/signals @preact/signals-core; do
    printf '%s\n\n' "$name $(node -p "require('./node_modules/$name/package.json').version")"
    cat "node_modules/$name/LICENSE"
    printf '\n'
done >"$out/LICENSE"
sha256sum "$out/preact.js"
