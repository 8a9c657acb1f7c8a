"""The life cycle of runs: every training takes place in a folder of this kind.

The folder exists from the start, and its ``run.json`` gives the status of the run: running, interrupted, failed or
done. Only one process at a time works in it. The last two checkpoints are kept: if the last one is damaged, the one
before it is used. A finished run has results instead of checkpoints, and ``run.json`` records their hashes.

Read ``folder`` first (begin, resume, checkpoint, finish, fail, replace), then ``record`` (``run.json``),
``config_file`` (``config.toml``), ``checkpoints``, ``inputs`` (the graph that a run was trained on), ``interruption``
(Ctrl-C) and ``seeds`` (a folder of runs that differ in the seed). In essence, training a model then reads::

    LINKS = RunKind(("train-complex", "train-links"), unit="epoch", progress=LinkProgress, judged_by="evaluate-links")

    with new_run(Path("models/mine"), LINKS) as run:
        run.begin(config, config.settings, inputs={"graph": graph.hash})
        for epoch in range(1, epochs + 1):
            ...
            run.checkpoints.save(epoch, tensors, LinkProgress(seconds=seconds))
            if run.interrupted.is_set():
                return run.interrupt()
        write_results(run.path)
        run.finish(("model.safetensors",), card="# My model")
"""
