#!/usr/bin/env bash
# Installs what only the tests need: a PostgreSQL server, which a test starts and stops by itself.
# Where it cannot be installed, the tests that need it are skipped with that reason.
set -euo pipefail

if compgen -G '/usr/lib/postgresql/*/bin/pg_ctl' >/dev/null || command -v pg_ctl >/dev/null 2>&1; then
    exit 0
fi
if [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null 2>&1; then
    apt-get update -qq
    # No cluster is made and no service is started: only the programs are wanted.
    mkdir -p /etc/postgresql-common
    [ -e /etc/postgresql-common/createcluster.conf ] || echo 'create_main_cluster = false' > /etc/postgresql-common/createcluster.conf
    DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends postgresql >/dev/null
    echo "test tools: PostgreSQL installed"
else
    echo "test tools: no PostgreSQL server, its tests are skipped; to run them: sudo apt-get install postgresql"
fi
