"""Foundations of every package: errors, records, settings, labels, files and statistics.

Read ``errors`` first: every error that a user can cause is one of its classes. Then read
``records`` (typed JSON, read strictly) and ``artefacts`` (files that are written whole or not at
all). ``settings`` checks the values of settings, ``extras`` names missing packages and lets other
packages add named objects, ``progress`` reports long work to a listener, if one is set. ``labels``,
``answers`` and ``wording`` read and write texts; ``statistics`` and ``tensors`` compute. Other
rooms import what many of them need from the package itself, and the rest from its modules.

This package imports no other package of wordcraft-kg. Texts of errors and new helpers may change
freely. Formats on disk may not: a changed :class:`~wordcraft_kg.base.records.Record` makes files
of earlier versions unreadable. The statistics are quoted in reports and papers, so a change there
needs a higher number in ``VERSIONS`` (``studies/plan.py``).
"""

from wordcraft_kg.base.artefacts import (
    TEMPORARY as TEMPORARY,
    check_file as check_file,
    check_output as check_output,
    check_output_file as check_output_file,
    drop_temporary as drop_temporary,
    dump_json as dump_json,
    json_text as json_text,
    made_folder as made_folder,
    output_target as output_target,
    read_json as read_json,
    read_large_file as read_large_file,
    read_small_file as read_small_file,
    sha256_of as sha256_of,
    staged_file as staged_file,
    staged_folder as staged_folder,
    what_is as what_is,
    with_a_name as with_a_name,
    write_atomically as write_atomically,
)
from wordcraft_kg.base.errors import (
    ActionError as ActionError,
    ArtefactError as ArtefactError,
    ConfigError as ConfigError,
    EpisodeError as EpisodeError,
    GraphError as GraphError,
    GraphMismatchError as GraphMismatchError,
    KnowledgeFileError as KnowledgeFileError,
    LeakError as LeakError,
    MissingExtraError as MissingExtraError,
    NotRegisteredError as NotRegisteredError,
    OutputExistsError as OutputExistsError,
    PlayerError as PlayerError,
    QueryFileError as QueryFileError,
    RecipeFileError as RecipeFileError,
    SplitError as SplitError,
    TaskError as TaskError,
    TrainingError as TrainingError,
    UnknownEntityError as UnknownEntityError,
    UnknownSettingError as UnknownSettingError,
    WordCraftKGError as WordCraftKGError,
    reason as reason,
)
from wordcraft_kg.base.progress import listening as listening, stage as stage, steps as steps
from wordcraft_kg.base.records import (
    Count as Count,
    Hash as Hash,
    Record as Record,
    Share as Share,
    as_lines as as_lines,
    as_record as as_record,
    as_values as as_values,
    checked_values as checked_values,
    parse_lines as parse_lines,
    parse_record as parse_record,
    read_record as read_record,
    schema_of as schema_of,
)
from wordcraft_kg.base.settings import (
    MAX_DIM as MAX_DIM,
    MAX_SIZE as MAX_SIZE,
    MAX_THREADS as MAX_THREADS,
    FeatureSpec as FeatureSpec,
    check_choices as check_choices,
    check_memory as check_memory,
    cores as cores,
    nearest as nearest,
    number_in as number_in,
    one_of as one_of,
    positive as positive,
    refuse as refuse,
    require as require,
    whole as whole,
)
from wordcraft_kg.base.wording import (
    counted as counted,
    for_html as for_html,
    for_terminal as for_terminal,
    listed as listed,
    quoted as quoted,
)
