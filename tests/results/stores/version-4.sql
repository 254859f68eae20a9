BEGIN TRANSACTION;
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
INSERT INTO "cells" VALUES('run-1','random','60204117ffa6ea06','maniskill/PushCube-v1','clean',0,1,1,0,0);
INSERT INTO "cells" VALUES('run-1','oracle','f131a0db68862d39','maniskill/PushCube-v1','clean',0,3,1,1,1);
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
	routing_s FLOAT NOT NULL, 
	wait_s FLOAT NOT NULL, 
	wall_s FLOAT NOT NULL, 
	PRIMARY KEY (run_id, episode_id), 
	FOREIGN KEY(run_id) REFERENCES runs (run_id)
);
INSERT INTO "episodes" VALUES('run-1','d1bf69b45f673e47','333176d29c63c781','maniskill','maniskill/PushCube-v1','oracle','f131a0db68862d39','clean',0,0,100,8,'third_person,wrist',96,'standard','success',1,40,5,0,1.5,'450192974d653567','4573210a3f327e90','976ee32eb3e7e006',NULL,NULL,NULL,NULL,NULL,NULL,NULL,1,'maniskill-0',1760000000.0,0.0,0.0,0.25,0.5,1.0,0.125,0.0,0.125,2.0);
INSERT INTO "episodes" VALUES('run-1','8fd57f4fb36a65ec','354572908e7eadce','maniskill','maniskill/PushCube-v1','oracle','f131a0db68862d39','clean',0,1,100,8,'third_person,wrist',96,'standard','failure',0,100,5,0,1.5,'65fc95cbb3826526','e6db8e162edaea94','b15aafe446efd84d',NULL,NULL,NULL,NULL,NULL,NULL,NULL,1,'maniskill-0',1760000001.0,0.0,0.0,0.25,0.5,1.0,0.125,0.0,0.125,2.0);
INSERT INTO "episodes" VALUES('run-1','67917774fc7b2de1','ab5b51d3f84e5461','maniskill','maniskill/PushCube-v1','oracle','f131a0db68862d39','clean',0,2,100,8,'third_person,wrist',96,'standard','error',0,0,0,0,0.0,'','','',NULL,NULL,NULL,NULL,NULL,NULL,'WorkerDied: signal 9',1,'w0',0.0,0.0,0.0,0.0,0.0,0.0,0.0,0.0,0.0,0.0);
INSERT INTO "episodes" VALUES('run-1','9bc90018445d854a','333176d29c63c781','maniskill','maniskill/PushCube-v1','random','60204117ffa6ea06','clean',0,0,100,8,'third_person,wrist',96,'standard','success',1,40,5,0,1.5,'450192974d653567','4573210a3f327e90','64f95f2ce5c5bf75',NULL,NULL,NULL,NULL,NULL,NULL,NULL,1,'maniskill-0',1760000000.0,0.0,0.0,0.25,0.5,1.0,0.125,0.0,0.125,2.0);
CREATE TABLE robogauntlet_schema (
	version INTEGER NOT NULL, 
	PRIMARY KEY (version)
);
INSERT INTO "robogauntlet_schema" VALUES(4);
CREATE TABLE runs (
	run_id TEXT NOT NULL, 
	started_at FLOAT NOT NULL, 
	document TEXT NOT NULL, suite TEXT, status TEXT, finished_at FLOAT, planned BIGINT, folder TEXT, rows_url TEXT, verdict TEXT, baseline TEXT, reasons TEXT, accepted BOOLEAN, schedule TEXT, live TEXT, 
	PRIMARY KEY (run_id)
);
INSERT INTO "runs" VALUES('run-1',1.79534906738120436662e+09,'{"suite": "synthetic", "suite_hash": "0123456789abcdef"}','synthetic',NULL,NULL,NULL,NULL,NULL,NULL,NULL,NULL,NULL,NULL,NULL);
CREATE INDEX robogauntlet_what_is_there ON episodes (run_id, policy_digest, task, axis, severity, seed, status);
CREATE INDEX robogauntlet_runs_by_suite ON runs (suite, started_at);
CREATE INDEX robogauntlet_runs_by_time ON runs (started_at);
CREATE INDEX robogauntlet_runs_by_status ON runs (status, started_at);
CREATE INDEX robogauntlet_runs_judged ON runs (started_at, suite) WHERE verdict IS NOT NULL;
CREATE INDEX robogauntlet_cells_by_policy ON cells (policy, run_id);
COMMIT;
