-- Schema 2: people and their consent, the whole proof of each frame, what was forgotten and who looked at what.
CREATE TABLE visitors (
  id                TEXT    PRIMARY KEY,                 -- pseudonym; no name, no birthday
  created_wall_ns   INTEGER NOT NULL
) STRICT;

-- What a visitor agreed to. Never edited: a new consent is a new row, a withdrawal sets withdrawn_wall_ns.
CREATE TABLE consents (
  number            INTEGER PRIMARY KEY AUTOINCREMENT,
  visitor           TEXT    NOT NULL REFERENCES visitors (id) ON DELETE CASCADE,
  text_version      TEXT    NOT NULL,                    -- of the text that was shown
  language          TEXT    NOT NULL,                    -- in which it was shown, such as 'de'
  fit               INTEGER NOT NULL CHECK (fit IN (0, 1)),
  research          INTEGER NOT NULL CHECK (research IN (0, 1)),
  publication       INTEGER NOT NULL CHECK (publication IN (0, 1)),
  given_wall_ns     INTEGER NOT NULL,
  withdrawn_wall_ns INTEGER                              -- NULL while it holds
) STRICT;
CREATE INDEX consents_by_visitor ON consents (visitor, number);

INSERT INTO visitors SELECT visitor, min(started_wall_ns) FROM sessions WHERE visitor <> '' GROUP BY visitor;

-- The consent a session was made under; sessions.consent of schema 1 keeps its text version.
ALTER TABLE sessions ADD COLUMN consent_json TEXT NOT NULL DEFAULT '';       -- as in the manifest; '' when none was asked
ALTER TABLE sessions ADD COLUMN retention TEXT NOT NULL DEFAULT 'standard'
  CHECK (retention IN ('short', 'standard', 'long', 'keep'));
ALTER TABLE sessions ADD COLUMN finished_wall_ns INTEGER;                    -- NULL while recording
ALTER TABLE sessions ADD COLUMN key_id BLOB;                                 -- of keys.sqlite; NULL: not encrypted
-- Totals kept with each commit of frames: counting a million rows takes longer than an operator waits.
ALTER TABLE sessions ADD COLUMN frame_count INTEGER NOT NULL DEFAULT 0;
ALTER TABLE sessions ADD COLUMN stored_bytes INTEGER NOT NULL DEFAULT 0;     -- payloads
UPDATE sessions SET frame_count = (SELECT count(*) FROM frames f WHERE f.session = sessions.number),
                    stored_bytes = (SELECT coalesce(sum(f.stored_bytes), 0) FROM frames f WHERE f.session = sessions.number);
CREATE INDEX sessions_by_visitor ON sessions (visitor);
CREATE INDEX sessions_by_start ON sessions (started_wall_ns);
CREATE INDEX sessions_by_calibration ON sessions (calibration_id);

ALTER TABLE calibrations ADD COLUMN rig TEXT NOT NULL DEFAULT '';
ALTER TABLE calibrations ADD COLUMN made_wall_ns INTEGER;                    -- NULL: not known

-- What proves that a frame shows its pattern (docs/file-formats.md); one row a frame.
CREATE TABLE proofs (
  session           INTEGER NOT NULL,
  frame             INTEGER NOT NULL,
  bracket           INTEGER NOT NULL,
  pose              INTEGER NOT NULL,
  trigger_number    INTEGER NOT NULL,
  trigger_ns        INTEGER NOT NULL,
  sync_ns           INTEGER NOT NULL,
  driver_sequence   INTEGER NOT NULL,
  frame_ns          INTEGER NOT NULL,
  frame_clock       INTEGER NOT NULL,
  exposure_ms       REAL    NOT NULL,
  gain              REAL    NOT NULL,
  mean_dn           REAL    NOT NULL,
  retake_cause      TEXT    NOT NULL,                    -- why the shot before did not count; '' for a first shot
  PRIMARY KEY (session, frame),
  FOREIGN KEY (session, frame) REFERENCES frames (session, frame) ON DELETE CASCADE
) STRICT, WITHOUT ROWID;

-- Certificates of what was forgotten: no pixels, no pseudonym. Copies lie in STORE/deletions/*.json.
CREATE TABLE deletions (
  session_id        TEXT    PRIMARY KEY,
  deleted_wall_ns   INTEGER NOT NULL,
  reason            TEXT    NOT NULL,                    -- 'forget' | 'purge'
  certificate_json  TEXT    NOT NULL
) STRICT;

-- Who showed, exported, opened what. Outlives the session it speaks of.
CREATE TABLE access_log (
  number            INTEGER PRIMARY KEY AUTOINCREMENT,
  at_wall_ns        INTEGER NOT NULL,
  who               TEXT    NOT NULL,                    -- operating-system user
  action            TEXT    NOT NULL,
  session_id        TEXT    NOT NULL,
  detail            TEXT    NOT NULL                     -- such as the folder of an export
) STRICT;
CREATE INDEX access_log_by_session ON access_log (session_id);

DROP VIEW session_overview;
CREATE VIEW session_overview AS
  SELECT s.number, s.id, s.kind, s.rig, s.visitor, s.status, s.simulated, s.retention, s.started_wall_ns, s.finished_wall_ns,
         s.calibration_id, s.key_id IS NOT NULL AS encrypted, s.frame_count AS frames, s.stored_bytes AS bytes,
         (SELECT count(*) FROM fits t WHERE t.session = s.number) AS fits
  FROM sessions s;
