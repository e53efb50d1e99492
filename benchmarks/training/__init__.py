"""Programs that train `brink-det@2`: labelled images, augmentation, the network, and its quantisation."""
