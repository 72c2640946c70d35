-- fit-quality: How good were the fits, day by day?
-- Figures of fit_overview: held-out stripe frames of the tied model, mean over the held-out projectors.
-- parameters: since until rig limit
-- column day          text   UTC, of the fit
-- column fits         number
-- column nrmse        number mean; normalised root mean square error, less is better
-- column nrmse_best   number
-- column nrmse_worst  number
-- column ssim         number mean structural similarity, 1 is equal
-- column divergence   number mean of the fits' median divergence
SELECT strftime('%Y-%m-%d', o.created_wall_ns / 1000000000, 'unixepoch') AS day, count(*) AS fits, avg(o.nrmse) AS nrmse,
       min(o.nrmse) AS nrmse_best, max(o.nrmse) AS nrmse_worst, avg(o.ssim) AS ssim, avg(o.divergence) AS divergence
FROM fit_overview o JOIN sessions s ON s.number = o.session
WHERE o.created_wall_ns >= coalesce(:since_ns, -9223372036854775808)
  AND o.created_wall_ns < coalesce(:until_ns, 9223372036854775807)
  AND (:rig IS NULL OR s.rig = :rig)
GROUP BY day
ORDER BY day DESC
LIMIT coalesce(:limit, -1)
