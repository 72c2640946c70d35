-- Schema 5: what the review of the store asked for. Frozen once released.

-- Comments. `.schema` of an index tells what each column means; ALTER TABLE ADD COLUMN of schemas 2 to 4 had lost theirs.
-- Only text is replaced, by the procedure that SQLite documents for what changes nothing on the disk
-- (https://sqlite.org/lang_altertable.html, section 7): columns, types and constraints are those that were there, which
-- tests hold. Before a table constraint a comment stands before its comma, where a later ADD COLUMN leaves it to its column.
PRAGMA writable_schema = ON;
UPDATE sqlite_schema SET sql = 'CREATE TABLE sessions (
  number            INTEGER PRIMARY KEY AUTOINCREMENT,   -- order of sessions; no clock decides it
  id                TEXT    NOT NULL UNIQUE,             -- such as s000017-3fa90c21; names the folder sessions/ID
  kind              TEXT    NOT NULL,                    -- visitor, calibration, dark, flat or response
  rig               TEXT    NOT NULL,                    -- name of the rig
  visitor           TEXT    NOT NULL,                    -- pseudonym; empty: shows nobody
  consent           TEXT    NOT NULL,                    -- version of the text that was shown; empty: none was asked
  simulated         INTEGER NOT NULL CHECK (simulated IN (0, 1)),  -- 1: made by the simulator
  seed              INTEGER NOT NULL,                    -- of the simulator; 0 on a real rig
  started_wall_ns   INTEGER NOT NULL,                    -- ns since 1970 UTC; for people only
  status            TEXT    NOT NULL CHECK (status IN (''recording'', ''complete'', ''degraded'', ''failed'')),  -- how it ended
  reasons_json      TEXT    NOT NULL,                    -- array of texts: why degraded or failed
  program_version   TEXT    NOT NULL,                    -- that captured it
  plan_json         TEXT    NOT NULL,                    -- options of the capture plan; empty: imported
  calibration_id    TEXT    REFERENCES calibrations (id),  -- captured with; NULL: without one
  consent_json      TEXT    NOT NULL DEFAULT '''',       -- as in the manifest; empty: none was asked
  retention         TEXT    NOT NULL DEFAULT ''standard''
    CHECK (retention IN (''short'', ''standard'', ''long'', ''keep'')),  -- class; its days: retention_classes
  finished_wall_ns  INTEGER,                             -- ns since 1970 UTC; NULL: while recording; 0: not known
  key_id            BLOB,                                -- of keys.sqlite; NULL: not encrypted
  frame_count       INTEGER NOT NULL DEFAULT 0,          -- kept with each commit of frames
  stored_bytes      INTEGER NOT NULL DEFAULT 0           -- of the payloads, kept with each commit of frames
) STRICT' WHERE type = 'table' AND name = 'sessions';
UPDATE sqlite_schema SET sql = 'CREATE TABLE calibrations (
  id                TEXT    PRIMARY KEY,                 -- XXH3-128 of the record
  record_json       TEXT    NOT NULL,                    -- as calibration.json holds it
  rig               TEXT    NOT NULL DEFAULT '''',       -- it is of; empty: schema 1 did not know
  made_wall_ns      INTEGER                              -- ns since 1970 UTC; NULL: not known
) STRICT' WHERE type = 'table' AND name = 'calibrations';
UPDATE sqlite_schema SET sql = 'CREATE TABLE frames (
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
  level_check       INTEGER NOT NULL /* 0: not checked, 1: passed, 2: failed */,
  PRIMARY KEY (session, frame)
) STRICT, WITHOUT ROWID' WHERE type = 'table' AND name = 'frames';
UPDATE sqlite_schema SET sql = 'CREATE TABLE fits (
  id                TEXT    NOT NULL,                    -- names the folder fits/ID of its session
  session           INTEGER NOT NULL REFERENCES sessions (number) ON DELETE CASCADE,  -- sessions.number
  options_json      TEXT    NOT NULL,                    -- it was made with
  metrics_json      TEXT    NOT NULL,                    -- metrics.json whole; its figures: metrics
  created_wall_ns   INTEGER NOT NULL /* ns since 1970 UTC */,
  PRIMARY KEY (session, id)
) STRICT, WITHOUT ROWID' WHERE type = 'table' AND name = 'fits';
UPDATE sqlite_schema SET sql = 'CREATE TABLE metrics (
  session           INTEGER NOT NULL REFERENCES sessions (number) ON DELETE CASCADE,  -- sessions.number
  fit               TEXT    NOT NULL,                    -- fits.id
  name              TEXT    NOT NULL,                    -- path in metrics.json, such as fit.divergence
  value             REAL /* figure; its unit is the end of its name */,
  PRIMARY KEY (session, fit, name)
) STRICT, WITHOUT ROWID' WHERE type = 'table' AND name = 'metrics';
UPDATE sqlite_schema SET sql = 'CREATE TABLE jobs (
  id                INTEGER PRIMARY KEY,                 -- in the order they were asked for
  session           INTEGER NOT NULL REFERENCES sessions (number) ON DELETE CASCADE,  -- sessions.number
  kind              TEXT    NOT NULL,                    -- such as fit
  state             TEXT    NOT NULL CHECK (state IN (''queued'', ''running'', ''done'', ''failed'')),  -- how far it is
  options_json      TEXT    NOT NULL,                    -- what is to be done
  message           TEXT    NOT NULL                     -- why it failed
) STRICT' WHERE type = 'table' AND name = 'jobs';
UPDATE sqlite_schema SET sql = 'CREATE TABLE visitors (
  id                TEXT    PRIMARY KEY,                 -- pseudonym; no name, no birthday
  created_wall_ns   INTEGER NOT NULL                     -- ns since 1970 UTC; first seen
) STRICT' WHERE type = 'table' AND name = 'visitors';
UPDATE sqlite_schema SET sql = 'CREATE TABLE consents (
  number            INTEGER PRIMARY KEY AUTOINCREMENT,   -- order of giving
  visitor           TEXT    NOT NULL REFERENCES visitors (id) ON DELETE CASCADE,  -- pseudonym
  text_version      TEXT    NOT NULL,                    -- of the text that was shown
  language          TEXT    NOT NULL,                    -- in which it was shown, such as de
  fit               INTEGER NOT NULL CHECK (fit IN (0, 1)),  -- 1: agreed to measuring and fitting
  research          INTEGER NOT NULL CHECK (research IN (0, 1)),  -- 1: agreed to research
  publication       INTEGER NOT NULL CHECK (publication IN (0, 1)),  -- 1: agreed to publication
  given_wall_ns     INTEGER NOT NULL,                    -- ns since 1970 UTC
  withdrawn_wall_ns INTEGER                              -- ns since 1970 UTC; NULL: while it holds
) STRICT' WHERE type = 'table' AND name = 'consents';
UPDATE sqlite_schema SET sql = 'CREATE TABLE proofs (
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
) STRICT, WITHOUT ROWID' WHERE type = 'table' AND name = 'proofs';
UPDATE sqlite_schema SET sql = 'CREATE TABLE deletions (
  session_id        TEXT    PRIMARY KEY,                 -- of what is gone
  deleted_wall_ns   INTEGER NOT NULL,                    -- ns since 1970 UTC
  reason            TEXT    NOT NULL,                    -- forget or purge
  certificate_json  TEXT    NOT NULL                     -- what was done and verified; no pixels, no pseudonym
) STRICT' WHERE type = 'table' AND name = 'deletions';
UPDATE sqlite_schema SET sql = 'CREATE TABLE access_log (
  number            INTEGER PRIMARY KEY AUTOINCREMENT,   -- order of entries
  at_wall_ns        INTEGER NOT NULL,                    -- ns since 1970 UTC
  who               TEXT    NOT NULL,                    -- operating-system user
  action            TEXT    NOT NULL,                    -- such as export
  session_id        TEXT    NOT NULL,                    -- the session itself may be gone
  detail            TEXT    NOT NULL                     -- such as the folder of an export
) STRICT' WHERE type = 'table' AND name = 'access_log';
UPDATE sqlite_schema SET sql = 'CREATE TABLE accepted_calibrations (
  session             INTEGER NOT NULL,                  -- sessions.number
  fit                 TEXT    NOT NULL,                  -- fits.id
  calibration_id      TEXT    NOT NULL REFERENCES calibrations (id),  -- the record in its folder
  made_wall_ns        INTEGER NOT NULL,                  -- ns since 1970 UTC; capture of the calibration session
  valid_until_wall_ns INTEGER NOT NULL /* ns since 1970 UTC */,
  PRIMARY KEY (session, fit),
  FOREIGN KEY (session, fit) REFERENCES fits (session, id) ON DELETE CASCADE
) STRICT, WITHOUT ROWID' WHERE type = 'table' AND name = 'accepted_calibrations';
PRAGMA writable_schema = RESET;

-- XXH3-128 of the samples (encrypted sessions: keyed BLAKE2b-128 under the session's key); NULL before schema 5.
-- It stays when a frame is transcoded: fits name frames by it.
ALTER TABLE frames ADD COLUMN pixel_hash BLOB /* of the samples, whatever the codec; NULL before schema 5 */;

-- Opening a store asks for sessions whose writer is gone: of a hundred thousand sessions one at most.
CREATE INDEX sessions_recording ON sessions (number) WHERE status = 'recording';

-- Jobs: what is to be done once, by whichever worker of this machine comes first (db/catalogue/job_store.h). The table
-- of schema 1 had neither leases nor jobs without a session; nothing wrote it. What stands in it comes along.
ALTER TABLE jobs RENAME TO jobs_of_schema_1;
CREATE TABLE jobs (
  id                INTEGER PRIMARY KEY AUTOINCREMENT,   -- older jobs first
  key               TEXT    NOT NULL UNIQUE,             -- the caller's: asking for the same again changes nothing
  session           INTEGER REFERENCES sessions (number) ON DELETE CASCADE,   -- NULL: of none alone
  kind              TEXT    NOT NULL,                    -- such as 'fit', 'calibrate'
  state             TEXT    NOT NULL                     -- how far it is
    CHECK (state IN ('queued', 'running', 'done', 'failed', 'set-aside', 'cancelled')),
  priority          INTEGER NOT NULL,                    -- higher first
  options_json      TEXT    NOT NULL,                    -- of the kind; names no visitor and no session
  created_wall_ns   INTEGER NOT NULL,                    -- ns since 1970 UTC
  not_before_wall_ns INTEGER NOT NULL,                   -- 0: at once
  attempts          INTEGER NOT NULL,                    -- leases so far, but those given back
  max_attempts      INTEGER NOT NULL CHECK (max_attempts >= 1),   -- then it is set aside, with last_error
  owner             TEXT    NOT NULL,                    -- worker that has it, or had it last; '' before
  fence             INTEGER NOT NULL,                    -- token of its newest lease; 0 before
  boot              TEXT    NOT NULL,                    -- boot id of the machine that until_boot_ns counts from; '' for none
  until_boot_ns     INTEGER NOT NULL,                    -- CLOCK_BOOTTIME; running: end of the lease; queued: of the back-off
  last_error        TEXT    NOT NULL,                    -- why the newest attempt failed; empty: none did
  finished_wall_ns  INTEGER                              -- NULL while queued or running
) STRICT;
INSERT INTO jobs (id, key, session, kind, state, priority, options_json, created_wall_ns, not_before_wall_ns, attempts,
                  max_attempts, owner, fence, boot, until_boot_ns, last_error, finished_wall_ns)
  SELECT id, 'schema 1: ' || id, session, kind, CASE state WHEN 'running' THEN 'queued' ELSE state END, 0, options_json,
         0, 0, 0, 3, '', 0, '', 0, message, CASE WHEN state IN ('done', 'failed') THEN 0 END
  FROM jobs_of_schema_1;
DROP TABLE jobs_of_schema_1;
CREATE INDEX jobs_queued ON jobs (priority DESC, id) WHERE state = 'queued';
CREATE INDEX jobs_running ON jobs (id) WHERE state = 'running';
CREATE INDEX jobs_by_session ON jobs (session) WHERE session IS NOT NULL;   -- a session's deletion looks here

-- The newest token of all leases. It starts anywhere, so that tokens of an index that was lost fit no lease of the one
-- that took its place, and only grows.
CREATE TABLE job_fence (
  one               INTEGER PRIMARY KEY CHECK (one = 1),   -- the table has one row
  last              INTEGER NOT NULL                     -- token of the newest lease
) STRICT;
INSERT INTO job_fence (one, last) VALUES (1, (random() & 0xfffffff) * 1000000);

-- Retention: which visitors' sessions of a class ended before a day, without reading the others; whose consent was
-- withdrawn.
CREATE INDEX sessions_by_end ON sessions (retention, CASE WHEN finished_wall_ns > 0 THEN finished_wall_ns ELSE started_wall_ns END)
  WHERE kind = 'visitor';
CREATE INDEX consents_withdrawn ON consents (visitor) WHERE withdrawn_wall_ns IS NOT NULL;

-- Operators. What `stratalux-db query` asks stands in views of plain SQL, so that sqlite3, DB Browser and Datasette give the
-- same answers (docs/store-queries.md). In views enumerations are words, and each *_wall_ns has a column without that end
-- beside it: UTC, ISO 8601 with nine digits of the second, from integers alone.

-- Of the plan in plan_json; what PlannedSteps() of the program counts, as SQL cannot build a plan.
ALTER TABLE sessions ADD COLUMN planned_steps INTEGER /* steps of the plan; NULL: no plan, or one this program cannot read */;

-- Of a hundred thousand sessions, those that may lack frames: missing_frames reads no other, the newest first.
CREATE INDEX sessions_incomplete ON sessions (number) WHERE status <> 'complete';

CREATE TABLE retention_classes (
  retention         TEXT    PRIMARY KEY,                 -- sessions.retention
  days              INTEGER                              -- kept after the end of the session; NULL: for ever
) STRICT, WITHOUT ROWID;
INSERT INTO retention_classes (retention, days) VALUES ('short', 30), ('standard', 365), ('long', 3650), ('keep', NULL);

-- One row a visitor's session: the consent it was made under; of the visitor's newest where that one is not known here.
-- NULL from `given_wall_ns` on: no consent is known here.
CREATE VIEW session_consents AS
  SELECT v.number AS session, v.visitor, c.number AS consent, c.text_version, c.language,
         ltrim(CASE WHEN c.fit = 1 THEN ', fit' ELSE '' END || CASE WHEN c.research = 1 THEN ', research' ELSE '' END ||
               CASE WHEN c.publication = 1 THEN ', publication' ELSE '' END, ', ') AS scope,
         c.given_wall_ns, c.withdrawn_wall_ns,
         strftime('%Y-%m-%dT%H:%M:%S', c.given_wall_ns / 1000000000, 'unixepoch')
           || printf('.%09dZ', c.given_wall_ns % 1000000000) AS given,
         strftime('%Y-%m-%dT%H:%M:%S', c.withdrawn_wall_ns / 1000000000, 'unixepoch')
           || printf('.%09dZ', c.withdrawn_wall_ns % 1000000000) AS withdrawn
  FROM (SELECT s.number, s.visitor,
               CASE WHEN json_valid(s.consent_json) THEN json_extract(s.consent_json, '$.given_wall_ns') END AS given_wall_ns
        FROM sessions s WHERE s.kind = 'visitor') v
  LEFT JOIN consents c ON c.number = coalesce(
    (SELECT max(m.number) FROM consents m WHERE m.visitor = v.visitor AND m.given_wall_ns = v.given_wall_ns),
    (SELECT max(m.number) FROM consents m WHERE m.visitor = v.visitor));

-- consent: {"text_version", "language", "scope", "given_wall_ns", "withdrawn"} of the consent it was made under; NULL: none.
DROP VIEW session_overview;
CREATE VIEW session_overview AS
  SELECT s.number, s.id, s.kind, s.rig, s.visitor, s.status, s.simulated, s.retention, s.started_wall_ns, s.finished_wall_ns,
         s.calibration_id, s.key_id IS NOT NULL AS encrypted, s.frame_count AS frames, s.stored_bytes AS bytes,
         (SELECT count(*) FROM fits t WHERE t.session = s.number) AS fits, s.planned_steps,
         strftime('%Y-%m-%dT%H:%M:%S', s.started_wall_ns / 1000000000, 'unixepoch')
           || printf('.%09dZ', s.started_wall_ns % 1000000000) AS started,
         strftime('%Y-%m-%dT%H:%M:%S', nullif(s.finished_wall_ns, 0) / 1000000000, 'unixepoch')
           || printf('.%09dZ', nullif(s.finished_wall_ns, 0) % 1000000000) AS finished,
         CASE WHEN json_valid(s.reasons_json) THEN json_extract(s.reasons_json, '$[0]') END AS first_reason,
         CASE WHEN s.consent <> '' OR json_valid(s.consent_json) THEN json_object(
           'text_version', coalesce(json_extract(s.consent_object, '$.text_version'), s.consent),
           'language', coalesce(json_extract(s.consent_object, '$.language'), ''),
           'scope', json(CASE json_type(s.consent_object, '$.scope') WHEN 'array'
                         THEN json_extract(s.consent_object, '$.scope') ELSE '[]' END),
           'given_wall_ns', coalesce(json_extract(s.consent_object, '$.given_wall_ns'), 0),
           'withdrawn', (SELECT c.withdrawn FROM session_consents c WHERE c.session = s.number)) END AS consent
  FROM (SELECT *, CASE WHEN json_valid(consent_json) THEN consent_json ELSE '{}' END AS consent_object FROM sessions) s;

-- One row a frame: its place and its proof together.
DROP VIEW frame_overview;
CREATE VIEW frame_overview AS
  SELECT f.session, f.frame, f.step, f.projector, f.phase, f.pattern, f.retry,
         CASE f.level_check WHEN 0 THEN 'not checked' WHEN 1 THEN 'passed' WHEN 2 THEN 'failed'
                            ELSE 'unknown ' || f.level_check END AS level_check,
         f.segment, f.offset, f.stored_bytes, f.hash, f.pixel_hash, p.bracket, p.pose, p.trigger_number, p.trigger_ns,
         p.sync_ns, p.driver_sequence, p.frame_ns,
         CASE p.frame_clock WHEN 0 THEN 'unknown' WHEN 1 THEN 'monotonic' WHEN 2 THEN 'simulated'
                            ELSE 'unknown ' || p.frame_clock END AS frame_clock,
         p.exposure_ms, p.gain, p.mean_dn, p.retake_cause
  FROM frames f LEFT JOIN proofs p ON p.session = f.session AND p.frame = f.frame;

-- One row a visitor's session that does not stay for ever: when `stratalux-db purge` takes it, and why. The days count from
-- its end, or from its start where it never ended; a withdrawn consent is due at once. `purge` with other days than those
-- of retention_classes (its flags, its --config) has its own opinion.
CREATE VIEW retention_ends AS
  SELECT number AS session, id, rig, visitor, reason, due_wall_ns, bytes,
         strftime('%Y-%m-%dT%H:%M:%S', due_wall_ns / 1000000000, 'unixepoch')
           || printf('.%09dZ', due_wall_ns % 1000000000) AS due
  FROM (SELECT s.number, s.id, s.rig, s.visitor, s.stored_bytes AS bytes,
               CASE WHEN c.withdrawn_wall_ns IS NULL THEN s.retention ELSE 'consent withdrawn' END AS reason,
               coalesce(c.withdrawn_wall_ns, coalesce(nullif(s.finished_wall_ns, 0), s.started_wall_ns)
                                             + r.days * 86400000000000) AS due_wall_ns
        FROM sessions s JOIN session_consents c ON c.session = s.number
        LEFT JOIN retention_classes r ON r.retention = s.retention)
  WHERE due_wall_ns IS NOT NULL;
-- What is due by now.
CREATE VIEW retention_due AS
  SELECT * FROM retention_ends WHERE due_wall_ns <= 1000000000 * CAST(strftime('%s', 'now') AS INTEGER);

-- One row a reason of a degraded or failed session. reason_class is the reason with N for every number ("12.5" and "1/2" are
-- one each), so that equal failures meet in one group: digits become 9, each 9 the pair (1)(2), what lies between the pairs
-- of one number goes, and the pair that is left is its N.
CREATE VIEW session_reasons AS
  SELECT s.number AS session, s.id, s.rig, s.kind, s.status, s.started_wall_ns,
         coalesce(r.value, '(no reason kept)') AS reason,
         coalesce(
           replace(replace(replace(replace(replace(
             replace(replace(replace(replace(replace(replace(replace(replace(replace(
               replace(replace(r.value, char(1), ' '), char(2), ' '),
               '0', '9'), '1', '9'), '2', '9'), '3', '9'), '4', '9'), '5', '9'), '6', '9'), '7', '9'), '8', '9'),
             '9', char(1, 2)), char(2, 1), ''), char(2) || '.' || char(1), ''), char(2) || '/' || char(1), ''),
             char(1, 2), 'N'), '(no reason kept)') AS reason_class,
         strftime('%Y-%m-%dT%H:%M:%S', s.started_wall_ns / 1000000000, 'unixepoch')
           || printf('.%09dZ', s.started_wall_ns % 1000000000) AS started
  FROM sessions s
  LEFT JOIN json_each(CASE WHEN json_valid(s.reasons_json) THEN s.reasons_json ELSE '[]' END) r
  WHERE s.status IN ('degraded', 'failed');
CREATE VIEW failures AS
  SELECT status, reason_class AS reason, count(DISTINCT session) AS sessions, count(DISTINCT rig) AS rigs,
         max(started_wall_ns) AS last_wall_ns, id AS example, started AS last
  FROM session_reasons
  GROUP BY status, reason_class;

-- One row a session that is not complete and lacks steps: a good frame is one whose level check did not fail. `steps` names
-- the runs between the good ones, such as 3, 17-20; -1 and the plan's length are the posts on either side, and the index
-- frames_by_step has them in order.
CREATE VIEW missing_frames AS
  SELECT number AS session, id, rig, status, started_wall_ns, planned, good, planned - good AS missing,
         (SELECT group_concat(CASE WHEN step + 1 = next - 1 THEN step + 1 ELSE (step + 1) || '-' || (next - 1) END, ', ')
          FROM (SELECT -1 AS step, coalesce((SELECT min(f.step) FROM frames f
                                             WHERE f.session = q.number AND f.level_check <> 2 AND f.step >= 0
                                               AND f.step < q.planned), q.planned) AS next
                UNION ALL
                SELECT f.step, lead(f.step, 1, q.planned) OVER (ORDER BY f.step) FROM frames f
                WHERE f.session = q.number AND f.level_check <> 2 AND f.step >= 0 AND f.step < q.planned)
          WHERE next > step + 1) AS steps,
         strftime('%Y-%m-%dT%H:%M:%S', started_wall_ns / 1000000000, 'unixepoch')
           || printf('.%09dZ', started_wall_ns % 1000000000) AS started
  FROM (SELECT s.number, s.id, s.rig, s.status, s.started_wall_ns, s.planned_steps AS planned,
               (SELECT count(*) FROM (SELECT DISTINCT f.step FROM frames f
                                      WHERE f.session = s.number AND f.level_check <> 2 AND f.step >= 0
                                        AND f.step < s.planned_steps)) AS good
        FROM sessions s
        WHERE s.status <> 'complete' AND s.planned_steps IS NOT NULL) q
  WHERE good < planned;

-- One row a fit, with the figures asked for most: held-out stripe frames of the tied model, measured direct light,
-- reconstructed geometry, mean over the held-out projectors.
DROP VIEW fit_overview;
CREATE VIEW fit_overview AS
  SELECT f.session, f.id, f.created_wall_ns,
         (SELECT m.value FROM metrics m WHERE m.session = f.session AND m.fit = f.id
            AND m.name = 'heldout.stripe.tied.total.measured.reconstructed.nrmse') AS nrmse,
         (SELECT m.value FROM metrics m WHERE m.session = f.session AND m.fit = f.id
            AND m.name = 'heldout.stripe.tied.total.measured.reconstructed.ssim') AS ssim,
         (SELECT m.value FROM metrics m WHERE m.session = f.session AND m.fit = f.id
            AND m.name = 'heldout.stripe.tied.total.measured.reconstructed.psnr_db') AS psnr_db,
         (SELECT m.value FROM metrics m WHERE m.session = f.session AND m.fit = f.id AND m.name = 'fit.divergence')
            AS divergence,
         (SELECT m.value FROM metrics m WHERE m.session = f.session AND m.fit = f.id AND m.name = 'fit.pixels') AS pixels,
         strftime('%Y-%m-%dT%H:%M:%S', f.created_wall_ns / 1000000000, 'unixepoch')
           || printf('.%09dZ', f.created_wall_ns % 1000000000) AS created
  FROM fits f;

CREATE VIEW consent_overview AS
  SELECT c.number, c.visitor, c.text_version, c.language,
         ltrim(CASE WHEN c.fit = 1 THEN ', fit' ELSE '' END || CASE WHEN c.research = 1 THEN ', research' ELSE '' END ||
               CASE WHEN c.publication = 1 THEN ', publication' ELSE '' END, ', ') AS scope,
         c.given_wall_ns, c.withdrawn_wall_ns,
         strftime('%Y-%m-%dT%H:%M:%S', c.given_wall_ns / 1000000000, 'unixepoch')
           || printf('.%09dZ', c.given_wall_ns % 1000000000) AS given,
         strftime('%Y-%m-%dT%H:%M:%S', c.withdrawn_wall_ns / 1000000000, 'unixepoch')
           || printf('.%09dZ', c.withdrawn_wall_ns % 1000000000) AS withdrawn
  FROM consents c;
CREATE VIEW access_overview AS
  SELECT a.number, a.at_wall_ns, a.who, a.action, a.session_id, a.detail,
         strftime('%Y-%m-%dT%H:%M:%S', a.at_wall_ns / 1000000000, 'unixepoch')
           || printf('.%09dZ', a.at_wall_ns % 1000000000) AS at
  FROM access_log a;

-- One row a job. A moment that is not known (of a job of schema 1), or not set, is NULL as text. until_boot_ns is left out:
-- it means nothing without the boot it counts from.
CREATE VIEW job_overview AS
  SELECT j.id, j.key, j.session, s.id AS session_id, s.rig, j.kind, j.state, j.priority, j.attempts, j.max_attempts,
         nullif(j.owner, '') AS owner, nullif(j.last_error, '') AS last_error, j.options_json,
         j.created_wall_ns, j.not_before_wall_ns, j.finished_wall_ns,
         strftime('%Y-%m-%dT%H:%M:%S', nullif(j.created_wall_ns, 0) / 1000000000, 'unixepoch')
           || printf('.%09dZ', nullif(j.created_wall_ns, 0) % 1000000000) AS created,
         strftime('%Y-%m-%dT%H:%M:%S', nullif(j.not_before_wall_ns, 0) / 1000000000, 'unixepoch')
           || printf('.%09dZ', nullif(j.not_before_wall_ns, 0) % 1000000000) AS not_before,
         strftime('%Y-%m-%dT%H:%M:%S', nullif(j.finished_wall_ns, 0) / 1000000000, 'unixepoch')
           || printf('.%09dZ', nullif(j.finished_wall_ns, 0) % 1000000000) AS finished
  FROM jobs j LEFT JOIN sessions s ON s.number = j.session;

-- As in schema 4, with the moments as text.
DROP VIEW calibration_overview;
DROP VIEW calibration_versions;
CREATE VIEW calibration_versions AS
  SELECT id, rig, simulated, session_id, fit, made_wall_ns, valid_until_wall_ns,
         row_number() OVER versions AS version, lead(id) OVER versions AS superseded_by,
         strftime('%Y-%m-%dT%H:%M:%S', made_wall_ns / 1000000000, 'unixepoch')
           || printf('.%09dZ', made_wall_ns % 1000000000) AS made,
         strftime('%Y-%m-%dT%H:%M:%S', valid_until_wall_ns / 1000000000, 'unixepoch')
           || printf('.%09dZ', valid_until_wall_ns % 1000000000) AS valid_until
  FROM (SELECT a.calibration_id AS id, s.rig, s.simulated, s.id AS session_id, a.fit, a.made_wall_ns,
               a.valid_until_wall_ns, f.created_wall_ns,
               row_number() OVER (PARTITION BY a.calibration_id ORDER BY f.created_wall_ns DESC, a.fit DESC) AS copy
        FROM accepted_calibrations a
        JOIN sessions s ON s.number = a.session
        JOIN fits f ON f.session = a.session AND f.id = a.fit)
  WHERE copy = 1
  WINDOW versions AS (PARTITION BY rig, simulated ORDER BY made_wall_ns, created_wall_ns, fit);
CREATE VIEW calibration_overview AS
  SELECT o.*,
         strftime('%Y-%m-%dT%H:%M:%S', made_wall_ns / 1000000000, 'unixepoch')
           || printf('.%09dZ', made_wall_ns % 1000000000) AS made,
         strftime('%Y-%m-%dT%H:%M:%S', since_wall_ns / 1000000000, 'unixepoch')
           || printf('.%09dZ', since_wall_ns % 1000000000) AS since,
         strftime('%Y-%m-%dT%H:%M:%S', first_used_wall_ns / 1000000000, 'unixepoch')
           || printf('.%09dZ', first_used_wall_ns % 1000000000) AS first_used,
         strftime('%Y-%m-%dT%H:%M:%S', last_used_wall_ns / 1000000000, 'unixepoch')
           || printf('.%09dZ', last_used_wall_ns % 1000000000) AS last_used,
         strftime('%Y-%m-%dT%H:%M:%S', valid_until_wall_ns / 1000000000, 'unixepoch')
           || printf('.%09dZ', valid_until_wall_ns % 1000000000) AS valid_until
  FROM (SELECT c.id, c.rig, c.source, c.made_wall_ns,
               coalesce(c.made_wall_ns,
                        (SELECT m.started_wall_ns FROM sessions m WHERE c.source = 'calibration session ' || m.id),
                        (SELECT min(s.started_wall_ns) FROM sessions s WHERE s.calibration_id = c.id)) AS since_wall_ns,
               (SELECT min(s.started_wall_ns) FROM sessions s WHERE s.calibration_id = c.id) AS first_used_wall_ns,
               (SELECT max(s.started_wall_ns) FROM sessions s WHERE s.calibration_id = c.id) AS last_used_wall_ns,
               (SELECT count(*) FROM sessions s WHERE s.calibration_id = c.id) AS sessions,
               v.version, v.session_id AS made_by, v.fit, v.superseded_by,
               coalesce(v.valid_until_wall_ns, c.valid_until_wall_ns) AS valid_until_wall_ns
        FROM (SELECT id,
                     coalesce(made_wall_ns,
                              CASE WHEN json_valid(record_json) THEN json_extract(record_json, '$.made_wall_ns') END)
                       AS made_wall_ns,
                     CASE WHEN json_valid(record_json) THEN json_extract(record_json, '$.valid_until_wall_ns') END
                       AS valid_until_wall_ns,
                     -- Records of schema 1 do not know their rig; the sessions do.
                     coalesce(nullif(rig, ''),
                              (SELECT s.rig FROM sessions s WHERE s.calibration_id = calibrations.id LIMIT 1), '') AS rig,
                     coalesce(CASE WHEN json_valid(record_json) THEN json_extract(record_json, '$.source') END, '') AS source
              FROM calibrations) c
        LEFT JOIN calibration_versions v ON v.id = c.id) o;

-- How far the index has followed each chain of ledger/ (db/catalogue/ledger_follow.h): bytes of it whose withdrawals and
-- forgettings stand in consents and deletions.
CREATE TABLE ledger_heads (
  chain             TEXT    PRIMARY KEY,                 -- file name in ledger/; '': withdrawals of before were taken over
  bytes             INTEGER NOT NULL                     -- of it that the index has followed
) STRICT, WITHOUT ROWID;
