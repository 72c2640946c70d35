# SPDX-License-Identifier: Apache-2.0
# A night by Snakemake (7 and later), on this machine or by any of its executors:
#   stratalux-fit batch plan --store store --out results
#   snakemake --snakefile night.smk --cores 4 --keep-going --config store=store results=results shards=8
# The store's index is written by `merge` alone, a local rule: run Snakemake where the store lies.
store, results = config["store"], config["results"]
shards = int(config["shards"])

localrules: merge

rule merge:
    input: expand("{results}/done/{i}-of-{n}", results=results, i=range(1, shards + 1), n=shards)
    output: touch(f"{results}/done/merged")
    shell: "stratalux-fit batch merge {results:q} --store {store:q}"

# No output of its own: a shard that is stopped keeps what it has made, and goes on. Visitors who could not be fitted (exit
# code 3) are told by the merge.
rule shard:
    input: ancient(f"{results}/plan.json")
    output: touch(f"{results}/done/{{i}}-of-{{n}}")
    threads: 1
    retries: 3
    shell: "stratalux-fit batch shard {wildcards.i}/{wildcards.n} --store {store:q} --results {results:q} --workers 1 --threads {threads} || [ $? -eq 3 ]"
