# To be sourced by jobs of hours. PERCENT (default 100): share of their demonstrations, steps and episodes, so that
# `PERCENT=1` shows in minutes whether every step goes through on a machine. What comes of it cannot act.
if ! [[ ${PERCENT:-100} =~ ^[1-9][0-9]{0,2}$ ]]; then
    echo "PERCENT: expected a whole number from 1 to 999, got '$PERCENT'" >&2
    exit 2
fi
few() {
    local part=$(($1 * ${PERCENT:-100} / 100)) least=3
    echo $((part > least ? part : least))
}
export -f few
