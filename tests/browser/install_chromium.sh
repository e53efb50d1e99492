#!/bin/sh
# Installs Chromium, in which the dashboard is tested, unless there is one: Debian's, for nothing else is downloaded.
# Where this may not install anything it says what to do; the tests then fail, and say the same.
set -eu

test -z "${TEST_CHROMIUM:-}" || exit 0
for name in chromium chromium-browser google-chrome; do
  if command -v "$name" >/dev/null; then exit 0; fi
done
if ! command -v apt-get >/dev/null; then
  echo "tests of the dashboard need Chromium: install it, or name one in TEST_CHROMIUM" >&2
  exit 0
fi
if [ "$(id -u)" -eq 0 ]; then
  as_root=env
elif sudo -n true 2>/dev/null; then
  as_root="sudo env"
else
  echo "tests of the dashboard need Chromium: sudo apt-get install chromium, or name one in TEST_CHROMIUM" >&2
  exit 0
fi
echo "installing Chromium for the tests of the dashboard"
$as_root apt-get update -qq
$as_root DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends chromium fonts-dejavu-core >/dev/null
