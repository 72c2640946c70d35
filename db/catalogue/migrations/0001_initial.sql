-- Schema 1. Frozen once released: later changes are migrations of their own.
CREATE TABLE sessions (
  number            INTEGER PRIMARY KEY AUTOINCREMENT,   -- order of sessions; no clock decides it
  id                TEXT    NOT NULL UNIQUE,
  kind              TEXT    NOT NULL,
  rig               TEXT    NOT NULL,
  visitor           TEXT    NOT NULL,                    -- pseudonym
  consent           TEXT    NOT NULL,
  simulated         INTEGER NOT NULL CHECK (simulated IN (0, 1)),
  seed              INTEGER NOT NULL,
  started_wall_ns   INTEGER NOT NULL,                    -- for people only
  status            TEXT    NOT NULL CHECK (status IN ('recording', 'complete', 'degraded', 'failed')),
  reasons_json      TEXT    NOT NULL,
  program_version   TEXT    NOT NULL,
  plan_json         TEXT    NOT NULL,
  calibration_id    TEXT    REFERENCES calibrations (id)
) STRICT;

CREATE TABLE calibrations (
  id                TEXT    PRIMARY KEY,                 -- XXH3-128 of the record
  record_json       TEXT    NOT NULL
) STRICT;

-- One row a frame: its place in a segment and its proof.
CREATE TABLE frames (
  session           INTEGER NOT NULL REFERENCES sessions (number) ON DELETE CASCADE,
  frame             INTEGER NOT NULL,                    -- 0-based within the session
  segment           INTEGER NOT NULL,                    -- frames-NNNN.seg
  offset            INTEGER NOT NULL,
  stored_bytes      INTEGER NOT NULL,
  hash              BLOB    NOT NULL,
  step              INTEGER NOT NULL,
  projector         INTEGER NOT NULL,
  phase             TEXT    NOT NULL,
  pattern           TEXT    NOT NULL,
  retry             INTEGER NOT NULL,
  level_check       INTEGER NOT NULL,
  PRIMARY KEY (session, frame)
) STRICT, WITHOUT ROWID;

CREATE TABLE fits (
  id                TEXT    NOT NULL,
  session           INTEGER NOT NULL REFERENCES sessions (number) ON DELETE CASCADE,
  options_json      TEXT    NOT NULL,
  metrics_json      TEXT    NOT NULL,
  created_wall_ns   INTEGER NOT NULL,
  PRIMARY KEY (session, id)
) STRICT, WITHOUT ROWID;

CREATE TABLE metrics (
  session           INTEGER NOT NULL REFERENCES sessions (number) ON DELETE CASCADE,
  fit               TEXT    NOT NULL,
  name              TEXT    NOT NULL,
  value             REAL,
  PRIMARY KEY (session, fit, name)
) STRICT, WITHOUT ROWID;

CREATE TABLE jobs (
  id                INTEGER PRIMARY KEY,
  session           INTEGER NOT NULL REFERENCES sessions (number) ON DELETE CASCADE,
  kind              TEXT    NOT NULL,
  state             TEXT    NOT NULL CHECK (state IN ('queued', 'running', 'done', 'failed')),
  options_json      TEXT    NOT NULL,
  message           TEXT    NOT NULL
) STRICT;

-- What an operator asks for first.
CREATE VIEW session_overview AS
  SELECT s.number, s.id, s.kind, s.rig, s.visitor, s.status, s.simulated, s.started_wall_ns,
         (SELECT count(*) FROM frames f WHERE f.session = s.number) AS frames,
         (SELECT coalesce(sum(f.stored_bytes), 0) FROM frames f WHERE f.session = s.number) AS bytes,
         (SELECT count(*) FROM fits t WHERE t.session = s.number) AS fits
  FROM sessions s;
