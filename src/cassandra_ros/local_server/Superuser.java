// SPDX-FileCopyrightText: 2026 cassandra_ros authors
// SPDX-License-Identifier: BSD-3-Clause

import org.apache.cassandra.io.sstable.CQLSSTableWriter;
import org.mindrot.jbcrypt.BCrypt;

/**
 * Writes a file of the table system_auth.roles that holds Cassandra's superuser with a password of
 * ours, for nodes that are not running. Cassandra makes the superuser with its public default
 * password only where that table is empty.
 *
 * The arguments are the folders to write to, one for each node; the password is in the variable
 * SUPERUSER_PASSWORD of the environment, because other users can see arguments.
 */
public class Superuser {
    public static void main(String[] folders) throws Exception {
        String hash = BCrypt.hashpw(System.getenv("SUPERUSER_PASSWORD"), BCrypt.gensalt());
        for (String folder : folders) {
            try (CQLSSTableWriter writer = CQLSSTableWriter.builder()
                    .inDirectory(folder)
                    .forTable("CREATE TABLE login.roles (role text PRIMARY KEY, is_superuser boolean, "
                        + "can_login boolean, salted_hash text, member_of set<text>)")
                    // Any later change of the role is newer, and the default one, with 0, older.
                    .using("INSERT INTO login.roles (role, is_superuser, can_login, salted_hash) "
                        + "VALUES (?, true, true, ?) USING TIMESTAMP 1")
                    .build()) {
                writer.addRow("cassandra", hash);
            }
        }
        System.exit(0);
    }
}
