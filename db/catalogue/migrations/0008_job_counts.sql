-- Schema 8: how many jobs of each kind are in each state, kept as they change: counting a million takes a quarter of a
-- second, and a worker asks after each visitor. Frozen once released.
CREATE TABLE job_counts (
  kind              TEXT    NOT NULL,                    -- jobs.kind
  state             TEXT    NOT NULL,                    -- jobs.state
  jobs              INTEGER NOT NULL CHECK (jobs >= 0),  -- so many; 0 where there were some
  PRIMARY KEY (kind, state)
) STRICT, WITHOUT ROWID;
INSERT INTO job_counts (kind, state, jobs) SELECT kind, state, count(*) FROM jobs GROUP BY kind, state;
CREATE TRIGGER jobs_counted_in AFTER INSERT ON jobs BEGIN
  INSERT INTO job_counts (kind, state, jobs) VALUES (NEW.kind, NEW.state, 1)
    ON CONFLICT (kind, state) DO UPDATE SET jobs = jobs + 1;
END;
CREATE TRIGGER jobs_counted_out AFTER DELETE ON jobs BEGIN
  UPDATE job_counts SET jobs = jobs - 1 WHERE kind = OLD.kind AND state = OLD.state;
END;
CREATE TRIGGER jobs_counted_on AFTER UPDATE OF kind, state ON jobs WHEN OLD.kind <> NEW.kind OR OLD.state <> NEW.state BEGIN
  UPDATE job_counts SET jobs = jobs - 1 WHERE kind = OLD.kind AND state = OLD.state;
  INSERT INTO job_counts (kind, state, jobs) VALUES (NEW.kind, NEW.state, 1)
    ON CONFLICT (kind, state) DO UPDATE SET jobs = jobs + 1;
END;
