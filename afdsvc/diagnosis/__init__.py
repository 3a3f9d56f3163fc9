"""From blocks to evidence and alarms, live and offline alike: no files, transport or threads."""
