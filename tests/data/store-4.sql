CREATE TABLE forgotten_runs (
    run_id TEXT NOT NULL,
    folder TEXT,
    PRIMARY KEY (run_id)
);
CREATE TABLE imported_runs (
    run_id TEXT NOT NULL,
    PRIMARY KEY (run_id)
);
CREATE TABLE robogauntlet_schema (
    version INTEGER NOT NULL,
    PRIMARY KEY (version)
);
CREATE TABLE runs (
    run_id TEXT NOT NULL,
    started_at FLOAT NOT NULL,
    document TEXT NOT NULL,
    suite TEXT NOT NULL,
    status TEXT NOT NULL,
    finished_at FLOAT,
    planned BIGINT NOT NULL,
    folder TEXT,
    rows_url TEXT,
    verdict TEXT,
    baseline TEXT,
    reasons TEXT,
    accepted BOOLEAN,
    schedule TEXT,
    live TEXT,
    PRIMARY KEY (run_id)
);
CREATE INDEX robogauntlet_runs_by_status ON runs (status, started_at);
CREATE INDEX robogauntlet_runs_by_suite ON runs (suite, started_at);
CREATE INDEX robogauntlet_runs_by_time ON runs (started_at);
CREATE INDEX robogauntlet_runs_judged ON runs (started_at, suite) WHERE verdict IS NOT NULL;
CREATE TABLE cells (
    run_id TEXT NOT NULL,
    policy TEXT NOT NULL,
    policy_digest TEXT NOT NULL,
    task TEXT NOT NULL,
    axis TEXT NOT NULL,
    severity BIGINT NOT NULL,
    planned BIGINT NOT NULL,
    successes BIGINT NOT NULL,
    failures BIGINT NOT NULL,
    errors BIGINT NOT NULL,
    PRIMARY KEY (run_id, policy_digest, task, axis, severity),
    FOREIGN KEY(run_id) REFERENCES runs (run_id) ON DELETE CASCADE
);
CREATE INDEX robogauntlet_cells_by_policy ON cells (policy, run_id);
CREATE TABLE episodes (
    run_id TEXT NOT NULL,
    episode_id TEXT NOT NULL,
    pair_id TEXT NOT NULL,
    simulator TEXT NOT NULL,
    task TEXT NOT NULL,
    policy TEXT NOT NULL,
    policy_digest TEXT NOT NULL,
    axis TEXT NOT NULL,
    severity BIGINT NOT NULL,
    seed BIGINT NOT NULL,
    horizon BIGINT NOT NULL,
    replan_every BIGINT NOT NULL,
    cameras TEXT NOT NULL,
    image_size BIGINT NOT NULL,
    render_profile TEXT NOT NULL,
    protocol TEXT,
    success_rule TEXT,
    status TEXT NOT NULL,
    success_once BOOLEAN NOT NULL,
    steps BIGINT NOT NULL,
    queries BIGINT NOT NULL,
    clipped_steps BIGINT NOT NULL,
    reward_sum FLOAT NOT NULL,
    state_hash TEXT NOT NULL,
    final_state_hash TEXT NOT NULL,
    actions_hash TEXT NOT NULL,
    inferred_task TEXT,
    routing_scores TEXT,
    unknown_score FLOAT,
    rejected BOOLEAN,
    delivered FLOAT,
    delivered_statistics TEXT,
    path_length FLOAT,
    smoothness FLOAT,
    time_to_success FLOAT,
    progress FLOAT,
    gripper_openings BIGINT,
    contact_steps BIGINT,
    contact_force FLOAT,
    joint_limit_steps BIGINT,
    workspace_steps BIGINT,
    failure TEXT,
    error TEXT,
    attempts BIGINT NOT NULL,
    worker TEXT NOT NULL,
    started_at FLOAT NOT NULL,
    build_s FLOAT NOT NULL,
    load_s FLOAT NOT NULL,
    reset_s FLOAT NOT NULL,
    physics_s FLOAT NOT NULL,
    render_s FLOAT NOT NULL,
    inference_s FLOAT NOT NULL,
    query_p50_s FLOAT,
    query_p95_s FLOAT,
    query_max_s FLOAT,
    routing_s FLOAT NOT NULL,
    wait_s FLOAT NOT NULL,
    wall_s FLOAT NOT NULL,
    PRIMARY KEY (run_id, episode_id),
    FOREIGN KEY(run_id) REFERENCES runs (run_id)
);
CREATE INDEX robogauntlet_what_is_there ON episodes (run_id, policy_digest, task, axis, severity, seed, status);
