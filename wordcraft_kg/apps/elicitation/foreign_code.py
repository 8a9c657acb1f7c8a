"""Refuse a pretrained model that would run code, before any library reads its folder.

A model folder from elsewhere is data of a stranger. Its JSON files can name Python classes to
import, kernels and other models to download, options that switch off a library's own checks, and
sizes that no memory holds. The libraries refuse most of that if asked to; this module refuses the
rest, and by name. It imports no library of models.
"""

import io
import os
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from math import prod
from pathlib import Path
from typing import Any

from wordcraft_kg.base.artefacts import SMALL_FILE, check_file, read_json, sha256_of
from wordcraft_kg.base.errors import (
    ArtefactError,
    ConfigError,
    MissingExtraError,
    WordCraftKGError,
    reason,
)
from wordcraft_kg.base.extras import check_extra, pip_install, unmet

_FORMATS = ("onnx/*", "openvino/*", "*.h5", "*.ot", "*.msgpack", "*.onnx", "*.gguf")
"""Weights in the formats of other libraries, in folders on the Hugging Face hub."""
_CODE = ("*.py", "*.pyc", "*.so", "*.bin", "*.pt", "*.pth", "*.pkl", "*.pickle", "*.ckpt")
"""Programs and pickles: no file of a model that runs code is needed here."""


def locate_model(setting: str, name: str) -> Path:
    """Return a model's path, after a download from the hub if it is not on disk.

    Files of other libraries are not downloaded, nor programs and pickles.

    Args:
        setting: name of the setting, for the error.
        name: path, or name on the Hugging Face hub.

    Raises:
        ConfigError: if there is no such path, and the model cannot be downloaded.
    """
    if os.path.exists(name):
        return Path(name)
    # Imported late: a model on disk needs no client of the hub.
    from huggingface_hub import snapshot_download

    try:
        return Path(snapshot_download(name, ignore_patterns=[*_FORMATS, *_CODE]))
    except (OSError, ValueError) as error:
        raise ConfigError(
            f"`{setting}` '{name}' is not on disk, and cannot be downloaded from the hub "
            f"({reason(error)}). Give the path of a model folder with config.json and weights."
        ) from None


def hash_weights(path: Path) -> dict[str, str]:
    """Return SHA-256 hashes of a model's weights by file name.

    Names are relative to the folder, so that a record tells nothing of the machine.

    Args:
        path: folder of a pretrained model; or a single file with all weights, such as ``.gguf``.

    Raises:
        ArtefactError: if the folder has no weights in safetensors, or no config.json.
    """
    if path.is_file():
        return {path.name: sha256_of(path)}
    files = weight_files(path)
    if not files or not (path / "config.json").is_file():
        missing = "config.json" if files else "weights (*.safetensors)"
        raise ArtefactError(
            f"'{path}' has no {missing}; expected the folder of a pretrained model. Download the "
            "whole folder."
        )
    return {file.relative_to(path).as_posix(): sha256_of(file) for file in files}


def weight_files(folder: Path) -> list[Path]:
    """Return the safetensors files of a model folder, and of its modules in folders inside."""
    files = sorted(folder.glob("*")) + sorted(folder.glob("*/*"))
    return [file for file in files if file.suffix == ".safetensors" and file.is_file()]


@contextmanager
def loading(path: Path, expected: str) -> Iterator[dict[str, str]]:
    """Check a model's files, and load it in this block without bars, warnings and questions.

    Args:
        path: the model.
        expected: kind of model in words, such as "a sentence encoder".

    Yields:
        SHA-256 hashes of the weights by file name.

    Raises:
        MissingExtraError: if a package is missing.
        ArtefactError: if the model is damaged, not of the ``expected`` kind, or needs code of its
            own.
    """
    check_extra("text")
    check_model_files(path)
    # Before loading, so that the hashes are of the files that were checked.
    hashes = hash_weights(path)
    stdin = sys.stdin
    try:
        # A library that asks "run the custom code? [y/N]" reads no answer, whatever stands in a
        # pipe.
        sys.stdin = io.StringIO()
        with (
            redirect_stderr(io.StringIO()),
            redirect_stdout(io.StringIO()),
            working(path, f"cannot be loaded as {expected}"),
        ):
            yield hashes
    finally:
        sys.stdin = stdin


@contextmanager
def working(path: str | Path, problem: str = "fails") -> Iterator[None]:
    """Turn errors of the libraries that load or use a model into one that names the model.

    Args:
        path: the model.
        problem: what an error means, in words.

    Raises:
        ArtefactError: for any error but those of this package.
    """
    try:
        yield
    except WordCraftKGError:
        raise
    except BaseException as error:  # libraries report damaged files by errors of many classes
        # A panic of the tokenizers, which are written in Rust, is no Exception.
        if not isinstance(error, Exception) and type(error).__name__ != "PanicException":
            raise
        # The only sign of this cause, which needs another remedy than a damaged file.
        if "trust_remote_code" in str(error):
            raise ArtefactError(
                f"'{path}' needs its own Python code, and code of a model is never run. Give a "
                "model that transformers itself knows."
            ) from None
        raise ArtefactError(
            f"'{path}' {problem}: {reason(error)}. Give another model, or restore a copy."
        ) from None


_MODULES = (
    *("Transformer", "Pooling", "Dense", "Normalize", "LayerNorm", "Dropout"),
    *("WeightedLayerPooling", "StaticEmbedding"),
)
_MODULE = re.compile(rf"sentence_transformers(\.[a-z_]+)*\.({'|'.join(_MODULES)})")
"""Modules of sentence encoders of text.

A path in the package alone is not enough: it also reaches the modules that the package imports.
"""
_MOST_MODULES = 16
"""Modules of a sentence encoder; usual are two to four, and each one loads its weights."""
_LONGEST_PROMPT = 10_000
"""Characters of a prompt in a folder, which precedes every label."""
_FOLDER_NAME = re.compile(r"[\w-][\w.-]*|")
_TOKENIZER = re.compile(r"(?!Auto)[A-Z]\w*(Tokenizer|TokenizerFast|Backend)")
_ACTIVATION = re.compile(r"torch\.nn\.modules\.(activation|linear)\.\w+")
_LOADER_OPTIONS = re.compile("(model|tokenizer|processor|config)_(args|kwargs)")
_HARMLESS_OPTIONS = {
    *("add_pooling_layer", "attn_implementation", "dtype", "torch_dtype", "is_causal"),
    *("is_decoder", "max_length", "model_max_length", "padding_side", "truncation_side"),
    *("use_fast", "do_lower_case", "add_bos_token", "add_eos_token"),
}
"""Options of a folder that change no more than sizes and text.

Others, such as weights_only, change what is trusted.
"""
_IMPLEMENTATION = re.compile(r"_?\w*implementation(_internal)?")
_WEIGHTS = re.compile(r"[\w-][\w.-]*\.safetensors")
_NOT_READ = ("tokenizer.json", "vocab.json")
"""Large JSON files of tokens, which name neither classes nor files."""
_ADAPTER = "adapter_config.json"
_TEXTS = (".json", ".jinja", ".txt", ".model")
"""Endings of settings, of templates, and of files of tokenizers."""


def check_sentence_transformers() -> None:
    """Raise MissingExtraError if sentence-transformers would run the code of a model folder.

    Versions before that of the extra ``text`` import any module that a local modules.json names,
    whatever they are told.
    """
    problem = unmet("text").get("sentence-transformers")
    if problem is not None:
        raise MissingExtraError(
            f"sentence-transformers {problem}; earlier versions run Python code that a model "
            f"folder names: {pip_install(extra='text')}"
        )


def check_model_files(path: Path) -> None:
    """Check a model folder, or a ``.gguf`` file and its neighbours, before a library reads them.

    Raises:
        ArtefactError: if a file names code, a kernel or another model to load, has weights as a
            pickle only, sets an option that the loader must decide, is a device or a pipe, or is a
            link out of the folder.
    """
    folder = path if path.is_dir() else path.parent
    if path.is_dir():
        # Only these folders are read; others hold what other libraries read, such as ONNX.
        templates = folder / "additional_chat_templates"
        files = []
        for place in (folder, *_module_folders(folder), *filter(Path.is_dir, [templates])):
            entries = [entry for entry in sorted(place.iterdir()) if not entry.is_dir()]
            _check_places(folder, entries)
            _check_weights(place)
            files += [entry for entry in entries if entry.suffix == ".json"]
    else:
        # The libraries read these names beside a .gguf file; other files there may be anybody's.
        names = ("config.json", "tokenizer_config.json", "generation_config.json", _ADAPTER)
        files = [folder / name for name in names if (folder / name).is_file()]
    for file in files:
        # To search all tokens takes long, and no loader imports a token.
        if file.name in _NOT_READ:
            continue
        if file.name == _ADAPTER:
            raise ArtefactError(
                f"'{folder}' is an adapter ({_ADAPTER}), which loads another model. Merge the "
                "adapter into its model, and give that folder."
            )
        for key, value in _items(read_json(file)):
            # Not `auto_map`, which many models of a kind that transformers has name, too: the
            # loaders refuse code that is needed, see `working`.
            _check_item(file, key, value)


def _module_folders(folder: Path) -> list[Path]:
    """Return the folders of modules that ``modules.json`` names.

    Raises:
        ArtefactError: if a class is no module of a text encoder, or a path is not the name of a
            folder in this one.
    """
    file = folder / "modules.json"
    if not os.path.lexists(file):
        return []
    content = read_json(file)
    modules = content if isinstance(content, list) else [content]
    if len(modules) > _MOST_MODULES:
        raise ArtefactError(
            f"'{file}' names {len(modules):,} modules; expected at most {_MOST_MODULES}. Give "
            "another model."
        )
    folders = []
    for module in modules:
        about = module if isinstance(module, dict) else {}
        kind = about.get("type")
        path = about.get("path")
        # A full match of the name: a prefix would reach any module below the package.
        if not isinstance(kind, str) or not _MODULE.fullmatch(kind):
            raise ArtefactError(
                f"'{file}' names the module {kind!r}, and code of a model is never run; expected "
                f"modules of sentence-transformers for text: {', '.join(_MODULES)}. Give another "
                "model."
            )
        if not isinstance(path, str) or not _FOLDER_NAME.fullmatch(path):
            raise ArtefactError(
                f"'{file}' has the path {path!r} of a module; expected the name of a folder. "
                "Restore a copy."
            )
        if path and (folder / path).is_dir():
            folders.append(folder / path)
    return folders


def _check_places(folder: Path, files: Iterable[Path]) -> None:
    """Refuse devices, pipes, links out of the model folder, and large files of text."""
    root = os.path.realpath(folder)
    inside = [root]
    # In a cache of the hub, the files of a model are links to the folder blobs beside its
    # snapshots.
    if os.path.basename(os.path.dirname(root)) == "snapshots":
        inside.append(os.path.join(os.path.dirname(os.path.dirname(root)), "blobs"))
    # realpath follows all links, also those of folders on the way.
    for file in files:
        place = os.path.realpath(file)
        if not any(Path(place).is_relative_to(root_folder) for root_folder in inside):
            raise ArtefactError(
                f"'{file}' is a link out of the model folder, to {place}. Replace the link by a "
                "copy of the file."
            )
        if not file.is_file():
            raise ArtefactError(f"'{file}' is not a regular file. Restore a copy.")
        # The libraries read these as a whole.
        if file.suffix in _TEXTS:
            check_file(file, SMALL_FILE)


def _check_weights(place: Path) -> None:
    """Refuse pickles without safetensors, and an index of safetensors that names other files."""
    pickles = sorted(place.glob("pytorch_model*.bin"))
    if pickles and not any(place.glob("model*.safetensors")):
        raise ArtefactError(
            f"'{place}' has weights as a pickle only, {pickles[0].name}, and a pickle can run "
            "code. Give a model with weights in model.safetensors."
        )
    for index in sorted(place.glob("*.index.json")):
        content = read_json(index)
        weight_map = content.get("weight_map") if isinstance(content, dict) else None
        for name in _strings(weight_map):
            if not _WEIGHTS.fullmatch(name):
                raise ArtefactError(
                    f"'{index}' names '{name}'; expected *.safetensors in the same folder. "
                    "Restore a copy."
                )


def _check_item(file: Path, key: str, value: Any) -> None:
    """Refuse a name and value of a JSON file that change what a loader imports or trusts."""
    problem = ""
    if key == "prompts" and any(len(text) > _LONGEST_PROMPT for text in _strings(value)):
        raise ArtefactError(
            f"'{file}' has a prompt of more than {_LONGEST_PROMPT:,} characters. Remove it, or "
            "give another model."
        )
    if _LOADER_OPTIONS.fullmatch(key) and isinstance(value, Mapping):
        odd = sorted(set(value) - _HARMLESS_OPTIONS)
        problem = f"sets the loader's option '{odd[0]}'" if odd else ""
    elif key in ("trust_remote_code", "use_kernels", "kernel_config") and value:
        problem = f"sets '{key}'"
    elif _IMPLEMENTATION.fullmatch(key) and any("/" in name for name in _strings(value)):
        problem = f"names a kernel to download, '{next(iter(_strings(value)))}'"
    elif key == "transformers_weights" and not _WEIGHTS.fullmatch(str(value)):
        problem = f"names the weights {value!r}; expected *.safetensors in the same folder"
    elif key == "tokenizer_class" and value is not None and not _TOKENIZER.fullmatch(str(value)):
        problem = f"names {value!r}, which is no class of a tokenizer"
    elif (
        key == "activation_function" and "." in str(value) and not _ACTIVATION.fullmatch(str(value))
    ):
        problem = f"names the activation function {value!r}, which is not one of torch"
    if problem:
        raise ArtefactError(
            f"'{file}' {problem}, and code of a model is never run. Give another model, or "
            "remove this setting."
        )


def _items(value: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    """Yield all values with the name of their setting, at any depth, also lists and mappings."""
    yield name, value
    if isinstance(value, Mapping):
        for inner_name, inner in value.items():
            yield from _items(inner, str(inner_name))
    elif isinstance(value, list | tuple):
        for inner in value:
            yield from _items(inner, name)


def _strings(value: Any) -> Iterator[str]:
    """Yield all texts among the values, at any depth."""
    yield from (inner for _, inner in _items(value) if isinstance(inner, str))


_COUNT = re.compile(r".*(layer|block|expert|group|depth|stage)(?!.*_size$).*|num_labels")
"""Names of numbers of parts, such as num_hidden_layers, n_layer or depths; block_size is a length.

transformers makes a text for each of the ``num_labels``, even for a model without classes.
"""
_MORE_PARTS = 1_024
"""Parts beyond the number of stored tensors: layers may share the tensors of one part."""
_MORE_ELEMENTS = 2**26
"""Elements beyond twice the stored ones: computed tables, and new parts such as a pooler."""


def check_counts(path: Path, config: Any) -> None:
    """Check the numbers of parts in a model's settings against its weights.

    The model is not built: even a model without values takes memory for each of its layers.

    Args:
        path: model folder or ``.gguf`` file.
        config: content of ``config.json``, or the settings in a ``.gguf`` file.

    Raises:
        ArtefactError: if a number of layers or other parts is far above the number of stored
            tensors.
    """
    limit = len(_shapes(path)) + _MORE_PARTS
    for name, value in _numbers(config):
        if value > limit and _COUNT.fullmatch(name):
            raise _too_large(path, f"{name} is {value:,}", f"at most {limit:,} for these weights")


def check_size(path: Path, build: Callable[[], Any]) -> None:
    """Check the size of a model against its weights.

    Args:
        path: model folder or ``.gguf`` file.
        build: builds the model, a torch module; called on torch's device meta, which holds no
            values.

    Raises:
        ArtefactError: if the model has far more elements than the weights.
    """
    import torch

    # Building a model draws from the global generator; its state is restored.
    with torch.random.fork_rng(devices=[]), torch.device("meta"):
        model = build()
    # Buffers count as well: tables of positions may be larger than the weights.
    num_elements = sum(tensor.numel() for tensor in (*model.parameters(), *model.buffers()))
    stored = sum(prod(shape) for shape in _shapes(path))
    limit = 2 * stored + _MORE_ELEMENTS
    if num_elements > limit:
        raise _too_large(path, f"config.json gives {num_elements:,} numbers", f"at most {limit:,}")


def check_modules(folder: Path) -> None:
    """Check the modules of a sentence encoder, each in a folder with settings and weights.

    Raises:
        ArtefactError: if a matrix of a module is far larger than the weights in the module's
            folder.
    """
    for file in sorted(folder.glob("*/config.json")):
        sizes = dict(_numbers(read_json(file)))
        matrix = sizes.get("in_features", 1) * sizes.get("out_features", 1)
        # Each kind of module has one of these sizes; a missing size counts as 1.
        num_elements = max(matrix, sizes.get("dimension", 1))
        stored = sum(prod(shape) for shape in _shapes(file.parent))
        if num_elements > 2 * stored + _MORE_ELEMENTS:
            raise _too_large(
                file.parent, f"config.json gives {num_elements:,} numbers", f"{stored:,}"
            )


def _too_large(path: Path, found: str, expected: str) -> ArtefactError:
    return ArtefactError(
        f"'{path}' is damaged: {found}, expected {expected}. Restore a copy of config.json and "
        "the weights."
    )


def _numbers(settings: Any) -> Iterator[tuple[str, int]]:
    """Yield all whole numbers in settings with the name of their setting, at any depth."""
    for name, value in _items(settings):
        # JSON may write a whole number as 1e9, which Python reads as a float.
        is_large_float = isinstance(value, float) and value > _MORE_PARTS and value == value // 1
        if is_large_float or (isinstance(value, int) and not isinstance(value, bool)):
            yield name, int(value)


def _shapes(path: Path) -> list[Sequence[int]]:
    """Return the shapes of all stored tensors; only the heads of the files are read."""
    if path.is_file():
        from gguf import GGUFReader

        return [tuple(map(int, tensor.shape)) for tensor in GGUFReader(path).tensors]
    from safetensors import safe_open

    shapes: list[Sequence[int]] = []
    for file in weight_files(path):
        with safe_open(file, framework="numpy") as tensors:
            names = tensors.keys()
            shapes += [tensors.get_slice(name).get_shape() for name in names]
    return shapes
