-- Schema 5: what the review of the store asked for. Frozen once released.

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
  state             TEXT    NOT NULL CHECK (state IN ('queued', 'running', 'done', 'failed', 'set-aside', 'cancelled')),
  priority          INTEGER NOT NULL,                    -- higher first
  options_json      TEXT    NOT NULL,                    -- of the kind; names no visitor and no session
  created_wall_ns   INTEGER NOT NULL,
  not_before_wall_ns INTEGER NOT NULL,                   -- 0: at once
  attempts          INTEGER NOT NULL,                    -- leases so far, but those given back
  max_attempts      INTEGER NOT NULL CHECK (max_attempts >= 1),   -- then it is set aside, with last_error
  owner             TEXT    NOT NULL,                    -- worker that has it, or had it last; '' before
  fence             INTEGER NOT NULL,                    -- token of its newest lease; 0 before
  boot              TEXT    NOT NULL,                    -- boot id of the machine that until_boot_ns counts from; '' for none
  until_boot_ns     INTEGER NOT NULL,                    -- CLOCK_BOOTTIME; running: end of the lease; queued: of the back-off
  last_error        TEXT    NOT NULL,
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
  one               INTEGER PRIMARY KEY CHECK (one = 1),
  last              INTEGER NOT NULL
) STRICT;
INSERT INTO job_fence (one, last) VALUES (1, (random() & 0xfffffff) * 1000000);

-- Retention: which visitors' sessions of a class ended before a day, without reading the others; whose consent was
-- withdrawn.
CREATE INDEX sessions_by_end ON sessions (retention, CASE WHEN finished_wall_ns > 0 THEN finished_wall_ns ELSE started_wall_ns END)
  WHERE kind = 'visitor';
CREATE INDEX consents_withdrawn ON consents (visitor) WHERE withdrawn_wall_ns IS NOT NULL;
