#!/usr/bin/env bash
# Installs what only the tests need, for the job that is named: for `test` a PostgreSQL server, which tests start and stop by
# themselves, and a browser that lays out reports without a screen; for `nightly` LaTeX too; for `chaos` Slurm, and `ip` for
# clusters of namespaces. Where they cannot be installed, tests are skipped and the whole check fails.
set -euo pipefail

job=${1:-test}
missing=()
if [ "$job" = chaos ]; then
    command -v ip >/dev/null 2>&1 || missing+=(iproute2)
    command -v slurmd >/dev/null 2>&1 || missing+=(munge slurmctld slurmd slurm-client)
else
    compgen -G '/usr/lib/postgresql/*/bin/pg_ctl' >/dev/null || command -v pg_ctl >/dev/null 2>&1 || missing+=(postgresql)
    command -v chromium >/dev/null 2>&1 || missing+=(chromium)
    [ "$job" != nightly ] || command -v pdflatex >/dev/null 2>&1 || missing+=(texlive-latex-recommended)
fi
if [ ${#missing[@]} = 0 ]; then
    exit 0
fi
if [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null 2>&1; then
    apt-get update -qq
    # No cluster is made and no service is started (RUNLEVEL=1): only the programs are wanted.
    mkdir -p /etc/postgresql-common
    [ -e /etc/postgresql-common/createcluster.conf ] || echo 'create_main_cluster = false' > /etc/postgresql-common/createcluster.conf
    RUNLEVEL=1 DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "${missing[@]}" >/dev/null
    echo "test tools: ${missing[*]} installed"
else
    echo "test tools: expected ${missing[*]}, which cannot be installed without root: sudo apt-get install ${missing[*]}"
fi
