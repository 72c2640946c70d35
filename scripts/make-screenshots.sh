#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Makes the documents' pictures of pages anew (docs/pictures), as the tests of the pages see them in Chromium.
#   scripts/make-screenshots.sh [BUILD]     a build folder with its tests built (default: build/release)
set -euo pipefail
cd "$(dirname "$0")/.."
build=${1:-build/release}
build=$(cd "$build" && pwd)
out=$(mktemp -d)
trap 'rm -rf "$out"' EXIT
ctest --test-dir "$build" -R '^web.modules$' --output-on-failure >&2
axe=$build/web/node_modules/axe-core/axe.min.js
/usr/bin/python3 tests/web/kiosk_page_test.py --program "$build/bin/kiosk_page_script" --rig "$build/bin/stratalux-rig" --axe "$axe" --pictures "$out" \
  Page.test_every_screen_in_english Page.test_every_screen_in_german Page.test_every_screen_in_japanese \
  Page.test_the_gate_keeps_only_what_is_worth_it Page.test_the_operators_screen Page.test_the_trend_of_the_self_checks >&2
/usr/bin/python3 tests/web/preview_page_test.py --program "$build/bin/stratalux-rig" --axe "$axe" --pictures "$out" \
  --scene head --size 696x520 Preview.test_light_exposure_and_figures >&2
while read -r from to; do
  cp "$out/$from.webp" "docs/pictures/$to.webp"
  echo "docs/pictures/$to.webp"
done <<'PICTURES'
en-idle kiosk_idle
en-question kiosk_question
de-consent kiosk_consent
en-position kiosk_position
en-countdown kiosk_countdown
en-capture kiosk_capture
ja-gate kiosk_gate
en-gate-nothing kiosk_gate_nothing
en-thanks kiosk_thanks
en-closed kiosk_closed
en-safe kiosk_safe
operator-en kiosk_operator
operator-trend-en kiosk_selfchecks
preview-lit preview
PICTURES
