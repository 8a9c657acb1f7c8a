"""People at the task: how their picks are read, the paper's protocol, the file of one person, the folder of a study."""
