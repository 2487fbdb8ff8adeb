"""The plants of the papers as rigs: `hil bench NAME`, `hil rig NAME`."""
