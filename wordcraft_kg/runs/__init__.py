"""One life cycle of runs: whatever trains, trains in a folder of this kind.

The folder is there from the start, and ``run.json`` in it says how the run stands: running, interrupted, failed or
done. One process at a time works in it. The last two checkpoints are kept; if the last one is damaged, the one before
is still there. A finished run has results instead of checkpoints, and ``run.json`` has their hashes.

Read ``folder`` first (begin, resume, checkpoint, finish, fail, replace), then ``record`` (``run.json``),
``config_file`` (``config.toml``), ``checkpoints``, ``inputs`` (the graph that a run was made with) and ``interruption``
(Ctrl-C). Training a model is then, in essence::

    LINKS = RunKind(("train-complex", "train-links"), unit="epoch", progress=LinkProgress)

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
