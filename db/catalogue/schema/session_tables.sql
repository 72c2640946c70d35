-- The tables that a session's rows lie in, as the migrations leave them, to the letter: a test holds that. `verify` compares
-- the index with rows rebuilt in memory; fifteen milliseconds of migrating an empty index for each `verify ID` are saved.
CREATE TABLE sessions (
  number            INTEGER PRIMARY KEY AUTOINCREMENT,   -- order of sessions; no clock decides it
  id                TEXT    NOT NULL UNIQUE,             -- such as s000017-3fa90c21; names the folder sessions/ID
  kind              TEXT    NOT NULL,                    -- visitor, calibration, dark, flat or response
  rig               TEXT    NOT NULL,                    -- name of the rig
  visitor           TEXT    NOT NULL,                    -- pseudonym; empty: shows nobody
  consent           TEXT    NOT NULL,                    -- version of the text that was shown; empty: none was asked
  simulated         INTEGER NOT NULL CHECK (simulated IN (0, 1)),  -- 1: made by the simulator
  seed              INTEGER NOT NULL,                    -- of the simulator; 0 on a real rig
  started_wall_ns   INTEGER NOT NULL,                    -- ns since 1970 UTC; for people only
  status            TEXT    NOT NULL CHECK (status IN ('recording', 'complete', 'degraded', 'failed')),  -- how it ended
  reasons_json      TEXT    NOT NULL,                    -- array of texts: why degraded or failed
  program_version   TEXT    NOT NULL,                    -- that captured it
  plan_json         TEXT    NOT NULL,                    -- options of the capture plan; empty: imported
  calibration_id    TEXT    REFERENCES calibrations (id),  -- captured with; NULL: without one
  consent_json      TEXT    NOT NULL DEFAULT '',       -- as in the manifest; empty: none was asked
  retention         TEXT    NOT NULL DEFAULT 'standard'
    CHECK (retention IN ('short', 'standard', 'long', 'keep')),  -- class; its days: retention_classes
  finished_wall_ns  INTEGER,                             -- ns since 1970 UTC; NULL: while recording; 0: not known
  key_id            BLOB,                                -- of keys.sqlite; NULL: not encrypted
  frame_count       INTEGER NOT NULL DEFAULT 0,          -- kept with each commit of frames
  stored_bytes      INTEGER NOT NULL DEFAULT 0           -- of the payloads, kept with each commit of frames
, planned_steps INTEGER /* steps of the plan; NULL: no plan, or one this program cannot read */, visit TEXT NOT NULL DEFAULT '' /* shared by the attempts of one visit; empty: not one of several */, attempt INTEGER NOT NULL DEFAULT 0 /* of the visit, from 1; 0: not counted */, findings_json TEXT NOT NULL DEFAULT '[]' /* array of findings, as in the manifest; rows: session_findings */, faults_json TEXT NOT NULL DEFAULT '{}' /* shots that did not count, by the fault's name; rows: session_faults */) STRICT;
CREATE TABLE calibrations (
  id                TEXT    PRIMARY KEY,                 -- XXH3-128 of the record
  record_json       TEXT    NOT NULL,                    -- as calibration.json holds it
  rig               TEXT    NOT NULL DEFAULT '',       -- it is of; empty: schema 1 did not know
  made_wall_ns      INTEGER                              -- ns since 1970 UTC; NULL: not known
) STRICT;
CREATE TABLE frames (
  session           INTEGER NOT NULL REFERENCES sessions (number) ON DELETE CASCADE,  -- sessions.number
  frame             INTEGER NOT NULL,                    -- 0-based within the session
  segment           INTEGER NOT NULL,                    -- N of the file frames-N.seg
  offset            INTEGER NOT NULL,                    -- of its header in the segment, bytes
  stored_bytes      INTEGER NOT NULL,                    -- of its payload
  hash              BLOB    NOT NULL,                    -- XXH3-128 of the payload as stored
  step              INTEGER NOT NULL,                    -- of the plan, 0-based
  projector         INTEGER NOT NULL,                    -- 0-based; -1: lit by all of them
  phase             TEXT    NOT NULL,                    -- of the plan, such as sweep
  pattern           TEXT    NOT NULL,                    -- shown, such as: comb columns period=16 phase=3
  retry             INTEGER NOT NULL,                    -- 0: first shot of the step
  level_check       INTEGER NOT NULL /* 0: not checked, 1: passed, 2: failed */, pixel_hash BLOB /* of the samples, whatever the codec; NULL before schema 5 */,
  PRIMARY KEY (session, frame)
) STRICT, WITHOUT ROWID;
CREATE TABLE fits (
  id                TEXT    NOT NULL,                    -- names the folder fits/ID of its session
  session           INTEGER NOT NULL REFERENCES sessions (number) ON DELETE CASCADE,  -- sessions.number
  options_json      TEXT    NOT NULL,                    -- it was made with
  metrics_json      TEXT    NOT NULL,                    -- metrics.json whole; its figures: metrics
  created_wall_ns   INTEGER NOT NULL /* ns since 1970 UTC */,
  PRIMARY KEY (session, id)
) STRICT, WITHOUT ROWID;
CREATE TABLE metrics (
  session           INTEGER NOT NULL REFERENCES sessions (number) ON DELETE CASCADE,  -- sessions.number
  fit               TEXT    NOT NULL,                    -- fits.id
  name              TEXT    NOT NULL,                    -- path in metrics.json, such as fit.divergence
  value             REAL /* figure; its unit is the end of its name */,
  PRIMARY KEY (session, fit, name)
) STRICT, WITHOUT ROWID;
CREATE TABLE visitors (
  id                TEXT    PRIMARY KEY,                 -- pseudonym; no name, no birthday
  created_wall_ns   INTEGER NOT NULL                     -- ns since 1970 UTC; first seen
) STRICT;
CREATE TABLE consents (
  number            INTEGER PRIMARY KEY AUTOINCREMENT,   -- order of giving
  visitor           TEXT    NOT NULL REFERENCES visitors (id) ON DELETE CASCADE,  -- pseudonym
  text_version      TEXT    NOT NULL,                    -- of the text that was shown
  language          TEXT    NOT NULL,                    -- in which it was shown, such as de
  fit               INTEGER NOT NULL CHECK (fit IN (0, 1)),  -- 1: agreed to measuring and fitting
  research          INTEGER NOT NULL CHECK (research IN (0, 1)),  -- 1: agreed to research
  publication       INTEGER NOT NULL CHECK (publication IN (0, 1)),  -- 1: agreed to publication
  given_wall_ns     INTEGER NOT NULL,                    -- ns since 1970 UTC
  withdrawn_wall_ns INTEGER                              -- ns since 1970 UTC; NULL: while it holds
) STRICT;
CREATE TABLE proofs (
  session           INTEGER NOT NULL,                    -- sessions.number
  frame             INTEGER NOT NULL,                    -- frames.frame
  bracket           INTEGER NOT NULL,                    -- number of its exposure within the step, from 0
  pose              INTEGER NOT NULL,                    -- of the board; -1: none
  trigger_number    INTEGER NOT NULL,                    -- counted by the rig; -1: free running
  trigger_ns        INTEGER NOT NULL,                    -- CLOCK_MONOTONIC; means nothing after a restart
  sync_ns           INTEGER NOT NULL,                    -- edge of the projector, CLOCK_MONOTONIC; 0: it has none
  driver_sequence   INTEGER NOT NULL,                    -- counted by the camera driver; -1: none
  frame_ns          INTEGER NOT NULL,                    -- stamp of the camera driver, of frame_clock
  frame_clock       INTEGER NOT NULL,                    -- 0: unknown, 1: monotonic, 2: simulated
  exposure_ms       REAL    NOT NULL,                    -- as the camera reports it
  gain              REAL    NOT NULL,                    -- as the camera reports it
  mean_dn           REAL    NOT NULL,                    -- mean raw level, for the level check
  retake_cause      TEXT    NOT NULL,                    -- why the shot before did not count; empty: a first shot
  PRIMARY KEY (session, frame),
  FOREIGN KEY (session, frame) REFERENCES frames (session, frame) ON DELETE CASCADE
) STRICT, WITHOUT ROWID;
CREATE TABLE accepted_calibrations (
  session             INTEGER NOT NULL,                  -- sessions.number
  fit                 TEXT    NOT NULL,                  -- fits.id
  calibration_id      TEXT    NOT NULL REFERENCES calibrations (id),  -- the record in its folder
  made_wall_ns        INTEGER NOT NULL,                  -- ns since 1970 UTC; capture of the calibration session
  valid_until_wall_ns INTEGER NOT NULL /* ns since 1970 UTC */,
  PRIMARY KEY (session, fit),
  FOREIGN KEY (session, fit) REFERENCES fits (session, id) ON DELETE CASCADE
) STRICT, WITHOUT ROWID;
