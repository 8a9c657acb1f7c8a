#!/bin/bash
# A study on four nodes: sbatch examples/ray_on_slurm.sh, in the folder of study.toml. Submitted again, it continues.
#SBATCH --nodes=4 --ntasks-per-node=1 --cpus-per-task=32 --exclusive --time=08:00:00
export RAY_AUTH_MODE=token RAY_AUTH_TOKEN=$(python -c 'import secrets; print(secrets.token_hex())')
head=$SLURMD_NODENAME
address=$head:$((20000 + SLURM_JOB_ID % 10000))
others=$((SLURM_JOB_NUM_NODES - 1))
ray start --head --port=${address#*:} --num-cpus=$SLURM_CPUS_PER_TASK
srun --nodes=$others --ntasks=$others --exclude=$head \
    ray start --address=$address --num-cpus=$SLURM_CPUS_PER_TASK --block &
wordcraft-kg reproduce study.toml --out results --engine ray --address $address
